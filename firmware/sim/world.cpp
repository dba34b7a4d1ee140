#include "firmware/sim/world.h"

#include <cmath>

namespace air {

namespace {

// What a bench would find. With equal replies a range errs by (n2 + 2 n4 + n6) / 4, where n are the noises of
// the three stamps of frames that came in.
std::uint16_t range_sigma_mm(double stamp_sigma_m) {
  return static_cast<std::uint16_t>(std::lround(1000.0 * stamp_sigma_m * std::sqrt(6.0) / 4.0));
}

}  // namespace

World::World(const Settings& settings) : settings_(settings), medium_(events_, settings.medium) {
  settings_.node.calibration.sigma_mm = range_sigma_mm(settings.medium.stamp_sigma_m);
}

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
