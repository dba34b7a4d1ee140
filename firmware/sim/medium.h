// The air between the antennas: what is sent at one comes to every other one, later, weaker and a little
// wrong.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <utility>
#include <vector>

#include "firmware/sim/chip.h"
#include "firmware/sim/events.h"
#include "firmware/sim/radio.h"
#include "firmware/sim/track.h"

namespace air {

// What became of an emission at one antenna, in truth. Its power comes in whatever its fate: others collide
// with it.
struct Passage {
  enum class Fate { kCame, kGarbled, kUnnoticed };

  std::uint16_t from = 0, to = 0;
  Arrival arrival;
  double distance_m = 0.0;
  // By how much later than along the straight line it is stamped, as lengths: noise, the bias by power, a
  // detour.
  double noise_m = 0.0, bias_m = 0.0, detour_m = 0.0;
  bool late = false;
  Fate fate = Fate::kCame;
};

class Medium : public Ether {
 public:
  struct Settings {
    std::uint64_t seed = 0;
    double stamp_sigma_m = 0.0;  // noise of each stamp, 1 sigma
    double frame_loss = 0.0;     // share of frames, at each receiver
  };

  Medium(Events& events, const Settings& settings) : events_(events), settings_(settings) {}

  // Both have to stay. No two of one address.
  void add(std::uint16_t address, Chip& chip, const Track& track);

  // From begin to before end signals between two antennas, either way, come this much late, and with a weak
  // first path. Spans of the same two must not overlap.
  void block(std::uint16_t a, std::uint16_t b, Femto begin, Femto end, double extra_m);

  // Spans that ended before t.
  void forget_before(Femto t);

  void send(Chip& from, const Emission& emission) override;

  std::function<void(std::uint16_t from, const Emission&)> on_emission;
  std::function<void(const Passage&)> on_passage;

 private:
  struct Antenna {
    std::uint16_t address;
    Chip* chip;
    const Track* track;
    std::uint64_t sent;  // emissions
  };
  struct Span {
    Femto end;
    double extra_m;
  };
  using Spans = std::map<Femto, Span>;  // by begin

  Passage pass(const Antenna& from, const Antenna& to, const Emission& emission) const;
  const Span* blocked(std::uint16_t a, std::uint16_t b, Femto t) const;  // null: line of sight

  Events& events_;
  Settings settings_;
  std::vector<Antenna> antennas_;
  std::map<std::pair<std::uint16_t, std::uint16_t>, Spans> blocked_;
};

}  // namespace air
