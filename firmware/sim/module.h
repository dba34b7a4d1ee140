// A module as it is carried about: a board that runs the node, its radio, and what nature makes of the two.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string_view>
#include <vector>

#include "firmware/sim/board.h"
#include "firmware/sim/chip.h"
#include "firmware/sim/dice.h"
#include "firmware/sim/events.h"
#include "firmware/sim/medium.h"
#include "firmware/sim/track.h"

extern "C" {
#include "firmware/core/node.h"
}

namespace air {

class Module {
 public:
  static constexpr Femto kForever = Femto{1} << 110;

  // From when to when it has power, and what holds in that time.
  struct Stint {
    Femto on = 0, off = kForever;
    double ppm = 0.0, board_ppm = 0.0;   // by how much the radio's and the board's crystal are too fast
    double antenna_delay_error_m = 0.0;  // by how much the delay that it is told makes ranges too long
    double temperature_c = 23.0;
  };
  using Key = std::array<std::uint8_t, WIRE_KEY_SIZE>;
  struct Spec {
    std::uint16_t address = 0;
    Track track;
    std::vector<Stint> stints;  // in the order of time
    Key key{};                  // what it says is tagged with it, and what it is told
  };

  // `common`: the settings that all nodes of a session share; address and key are the spec's.
  Module(Events& events, Medium& medium, std::uint64_t seed, const struct node_settings& common, Spec spec);

  std::uint16_t address() const { return spec_.address; }
  Board& board() { return board_; }
  const Board& board() const { return board_; }
  Chip& chip() { return chip_; }
  const Key& key() const { return spec_.key; }
  Track& track() { return track_; }

  // Power comes and goes now: for modules whose stints are not known before.
  void switch_on(const Stint& stint) { begin(stint); }
  void switch_off() { end(); }

  const struct node& node() const { return node_; }  // means nothing where the board has no power or sleeps
  std::uint32_t starts() const { return starts_; }   // so far

  // When its network's clock showed `time_ns`, less than 8 s from now; nothing where it has no clock of that
  // epoch.
  std::optional<Femto> moment_of(std::uint32_t epoch, std::int64_t time_ns) const;

  // What it does now is something else than before, in words.
  std::function<void(std::string_view words)> on_state;

 private:
  void begin(const Stint& stint);
  void end();
  void wander();
  std::uint64_t run(bool slept);
  std::string_view state() const;
  void tell_state();

  Events& events_;
  const Spec spec_;
  Track track_;
  const std::int64_t nominal_delay_;  // ticks
  Dice dice_;
  double wandered_ppm_ = 0.0;
  Femto wandered_at_ = 0;
  Events::Id wanders_next_;
  Chip chip_;
  Board board_;
  Stint stint_;
  struct node_settings settings_;
  struct node node_{};
  std::uint32_t starts_ = 0;  // kept as in flash
  std::string_view told_ = state();
};

}  // namespace air
