// What `synchronizar-air` is told: the text that SCENARIO.md describes.
#pragma once

#include <cstdint>
#include <istream>
#include <stdexcept>
#include <string>
#include <vector>

#include "firmware/sim/world.h"

struct Scenario {
  struct Late {
    std::uint16_t a = 0, b = 0;
    air::Femto begin = 0, end = 0;
    double extra_m = 0.0;
  };

  air::Femto length = 0;
  air::World::Settings settings;
  std::vector<air::Module::Spec> nodes;
  std::vector<Late> late;
};

// Names file, line and fault.
struct ScenarioError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

Scenario read_scenario(std::istream& text, const std::string& file);

// Of the live air: what holds for all its modules, which come later.
air::World::Settings read_settings(std::istream& text, const std::string& file);
