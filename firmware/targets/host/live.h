// The air that is steered while it runs: modules come, move and go as lines say (SCENARIO.md, "Live").
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "firmware/sim/world.h"
#include "firmware/targets/host/words.h"

namespace air {

class Live {
 public:
  explicit Live(World& world) : world_(world) {}

  // What one line says. Throws std::invalid_argument, in words, what is wrong with it; then nothing has
  // changed.
  void take(const std::string& line);

  // How far the air may run: to the newest place of whoever has told the least, and not before now. Nothing:
  // it stands still.
  std::optional<Femto> horizon() const;

  // On to t, or to the horizon.
  void run_until(Femto t);

 private:
  struct Carried {
    Module::Key key{};
    Module::Stint stint;
    Module* module = nullptr;  // once it has power
    Track before;              // until then
    bool stays = false;        // from its newest place on

    Track& track() { return module != nullptr ? module->track() : before; }
    const Track& track() const { return module != nullptr ? module->track() : before; }
  };

  void add(Words& words);
  void place(Words& words);
  void block(Words& words);
  void stay(std::uint16_t address);
  void remove(std::uint16_t address);
  Carried& known(std::uint16_t address);
  void switch_on_who_is_there();
  Femto next_to_come(Femto until) const;
  void forget();

  World& world_;
  std::map<std::uint16_t, Carried> carried_;
  Femto forgotten_ = 0;  // all before
};

}  // namespace air
