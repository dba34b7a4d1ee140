// Modules in a room, and what they tell, beside the truth.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "firmware/sim/world.h"

extern "C" {
#include "firmware/core/wire.h"
}

namespace air {

// A distance that a module told.
struct Told {
  std::uint16_t reporter = 0, peer = 0;
  struct wire_range range{};
  std::uint32_t epoch = 0;
  double clock_s = 0.0;  // by the network's clock
  double at_s = 0.0;     // when it was told
  double error_m = 0.0;  // what it is too long by
};

inline Track resting(const Position& place) {
  Track track;
  track.add(0, place);
  return track;
}

// Each module has a key of its own: the address, then 2, 3, ...
inline Module::Key key_of(std::uint16_t address) {
  Module::Key key{};
  for (std::size_t i = 0; i < key.size(); ++i) key[i] = static_cast<std::uint8_t>(i);
  key[0] = static_cast<std::uint8_t>(address & 0xFF);
  key[1] = static_cast<std::uint8_t>(address >> 8);
  return key;
}

class Room {
 public:
  struct Settings {
    std::uint8_t scheme = SCHEME_ONE_TO_N;
    double stamp_sigma_m = 0.0, frame_loss = 0.0;
    std::uint32_t range_s = 0, sleep_s = 0;
    std::uint64_t seed = 1;
    std::uint8_t channel = 5, prf_mhz = 64;
  };

  explicit Room(const Settings& settings) : world(world_settings(settings)) {
    world.on_datagram = [this](std::uint16_t from, const std::uint8_t* bytes, std::size_t size) {
      take(from, bytes, size);
      return true;
    };
  }

  // Crystals are spread over +-20 ppm, by address.
  Module& add(std::uint16_t address, const Position& place, Module::Stint stint = {}) {
    return add(address, resting(place), {stint});
  }
  Module& add(std::uint16_t address, const Track& track, std::vector<Module::Stint> stints) {
    for (Module::Stint& stint : stints) {
      stint.ppm += static_cast<double>((address * 13) % 41 - 20);
      stint.board_ppm += static_cast<double>((address * 7) % 41 - 20);
    }
    tracks_.emplace(address, track);
    return world.add({address, track, std::move(stints), key_of(address)});
  }

  void run(double until_s) { world.run_until(seconds(until_s)); }

  double now_s() { return to_seconds(world.events().now()); }

  // Distances between two, whoever told them, from one moment to another.
  std::vector<Told> between(std::uint16_t a, std::uint16_t b, double from_s = 0.0, double to_s = 1e18) const {
    std::vector<Told> found;
    for (const Told& one : told) {
      const bool ours = (one.reporter == a && one.peer == b) || (one.reporter == b && one.peer == a);
      if (ours && from_s <= one.at_s && one.at_s < to_s) found.push_back(one);
    }
    return found;
  }

  World world;
  std::vector<Told> told;
  std::size_t undecodable = 0;

 private:
  static World::Settings world_settings(const Settings& settings) {
    World::Settings world;
    world.medium = {settings.seed, settings.stamp_sigma_m, settings.frame_loss};
    world.node.session = 0xBEEF1234;
    world.node.scheme = settings.scheme;
    world.node.channel = settings.channel;
    world.node.prf_mhz = settings.prf_mhz;
    world.node.range_s = settings.range_s;
    world.node.sleep_s = settings.sleep_s;
    return world;
  }

  void take(std::uint16_t from, const std::uint8_t* bytes, std::size_t size) {
    struct wire_ranges said{};
    if (!wire_read_ranges(bytes, size, key_of(from).data(), &said) || said.reporter != from) {
      ++undecodable;
      return;
    }
    for (unsigned i = 0; i < said.count; ++i) {
      Told one;
      one.reporter = from;
      one.peer = said.range[i].peer;
      one.range = said.range[i];
      one.epoch = said.epoch;
      one.clock_s = static_cast<double>(said.time_ns) * 1e-9 + said.range[i].offset_us * 1e-6;
      one.at_s = now_s();
      const Femto now = world.events().now();
      // Where the room does not know the tracks the error means nothing.
      if (tracks_.count(from) > 0 && tracks_.count(one.peer) > 0) {
        const double true_m = distance(tracks_.at(from).at(now), tracks_.at(one.peer).at(now));
        one.error_m = one.range.distance_mm * 1e-3 - true_m;
      }
      told.push_back(one);
    }
  }

  std::map<std::uint16_t, Track> tracks_;
};

struct Spread {
  std::size_t n = 0;
  double mean = 0.0, sigma = 0.0, worst = 0.0;
};

inline Spread spread(const std::vector<Told>& told) {
  Spread found;
  found.n = told.size();
  for (const Told& one : told) {
    found.mean += one.error_m / static_cast<double>(found.n);
    found.worst = std::max(found.worst, std::abs(one.error_m));
  }
  for (const Told& one : told) {
    found.sigma += (one.error_m - found.mean) * (one.error_m - found.mean) / static_cast<double>(found.n);
  }
  found.sigma = std::sqrt(found.sigma);
  return found;
}

// A place of its own for each of so many: on a circle of 4 m.
inline Position on_circle(int i, int of) {
  const double angle = 6.283185307179586 * i / of;
  return {4.0 * std::cos(angle), 4.0 * std::sin(angle), 1.2};
}

}  // namespace air
