#include "firmware/sim/world.h"

namespace air {

World::World(const Settings& settings) : settings_(settings), medium_(events_, settings.medium) {}

Module& World::add(const Module::Spec& spec) {
  auto module = std::make_unique<Module>(events_, medium_, settings_.medium.seed, settings_.node, spec);
  const std::uint16_t address = spec.address;
  module->board().on_send = [this, address](const std::uint8_t* datagram, std::size_t size) {
    return on_datagram && on_datagram(address, datagram, size);
  };
  module->on_state = [this, address](std::string_view words) {
    if (on_state) on_state(address, words);
  };
  return *modules_.emplace(address, std::move(module)).first->second;
}

void World::run_until(Femto t) {
  // A board goes on alone as long as nothing else is due; it must not go past t.
  const Events::Id after = events_.at(t + 1, [] {});
  events_.run_until(t);
  events_.cancel(after);
}

}  // namespace air
