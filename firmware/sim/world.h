// Modules in the air: all that is simulated, in one piece.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string_view>

#include "firmware/sim/events.h"
#include "firmware/sim/medium.h"
#include "firmware/sim/module.h"

extern "C" {
#include "firmware/core/node.h"
}

namespace air {

class World {
 public:
  struct Settings {
    Medium::Settings medium;      // its seed is that of all else too
    struct node_settings node{};  // what all nodes share
  };

  explicit World(const Settings& settings);

  Module& add(const Module::Spec& spec);
  Module& module(std::uint16_t address) { return *modules_.at(address); }
  const std::map<std::uint16_t, std::unique_ptr<Module>>& modules() const { return modules_; }
  Events& events() { return events_; }
  Medium& medium() { return medium_; }

  void run_until(Femto t);

  // A module sends a datagram; false: the network does not take it.
  std::function<bool(std::uint16_t from, const std::uint8_t* datagram, std::size_t size)> on_datagram;
  std::function<void(std::uint16_t module, std::string_view words)> on_state;

 private:
  Settings settings_;
  Events events_;
  Medium medium_;
  std::map<std::uint16_t, std::unique_ptr<Module>> modules_;
};

}  // namespace air
