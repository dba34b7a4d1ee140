// What nature makes of a module: how fast its clocks are, how they wander, how modules differ; and when what
// it tells happened.
#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <set>
#include <vector>

#include "firmware/tests/sim/room.h"
#include "tests/cpp/check.h"

using namespace air;

namespace {

struct Moments {
  double mean = 0.0, sigma = 0.0;
};

Moments moments(const std::vector<double>& values) {
  Moments found;
  const auto n = static_cast<double>(values.size());
  for (const double value : values) found.mean += value / n;
  for (const double value : values) found.sigma += (value - found.mean) * (value - found.mean) / n;
  found.sigma = std::sqrt(found.sigma);
  return found;
}

Module::Spec module_at_rest(double ppm, double board_ppm) {
  Module::Stint stint;
  stint.ppm = ppm;
  stint.board_ppm = board_ppm;
  return {1, resting({0.0, 0.0, 1.0}), {stint}};
}

void both_clocks_are_as_fast_as_is_said() {
  Room room({});
  Module& module = room.world.add(module_at_rest(12.5, -70.0));
  const auto counted = [&] {
    return static_cast<double>(module.chip().crystal().ticks(room.world.events().now()));
  };
  room.run(1.0);
  const double before = counted();
  room.run(11.0);
  CHECK_NEAR(((counted() - before) / 638'976'000'000.0 - 1.0) * 1e6, 12.5, 0.1);
  const struct hal* hal = module.board().hal();
  CHECK(hal->now_us(hal->board) == 10'999'230);
}

// By 0.01 ppm in each second, 1 sigma.
void a_radios_crystal_wanders_about_where_it_was_put() {
  Room room({});
  Module& module = room.world.add(module_at_rest(12.5, 0.0));
  std::vector<double> steps;
  double before = 12.5;
  for (int second = 1; second <= 100; ++second) {
    room.run(second);
    const double ppm = module.chip().crystal().ppm();
    CHECK_NEAR(ppm, 12.5, 0.5);
    steps.push_back(ppm - before);
    before = ppm;
  }
  CHECK_NEAR(moments(steps).mean, 0.0, 0.004);
  CHECK_NEAR(moments(steps).sigma, 0.01, 0.003);
}

// 10 cm of a range, 1 sigma: 42.6 ticks of 15.65 ps for the way to and fro.
void modules_differ_in_their_antenna_delays() {
  Room room({});
  for (std::uint16_t i = 1; i <= 100; ++i) room.add(i, on_circle(i, 100));
  room.run(0.0001);
  std::vector<double> ticks;
  for (const auto& [address, module] : room.world.modules())
    ticks.push_back(module->node().settings.calibration.antenna_delay);
  CHECK_NEAR(moments(ticks).mean, 32'873.0, 15.0);
  CHECK_NEAR(moments(ticks).sigma, 42.6, 10.0);
}

// Of each range that is told: a frame of its reporter's was on air when it says that it was measured.
void the_moment_of_each_range_is_that_of_a_frame() {
  Room room({});
  std::map<std::uint16_t, std::set<Femto>> sent;
  room.world.medium().on_emission = [&](std::uint16_t from, const Emission& emission) {
    sent[from].insert(emission.marker);
  };
  std::size_t ranges = 0, unknown = 0;
  double worst_s = 0.0, oldest_s = 0.0;
  room.world.on_datagram = [&](std::uint16_t from, const std::uint8_t* datagram, std::size_t size) {
    struct wire_ranges told{};
    CHECK(wire_read_ranges(datagram, size, key_of(from).data(), &told));
    const Module& module = room.world.module(from);
    const auto time_ns = static_cast<std::int64_t>(told.time_ns);
    CHECK(!module.moment_of(told.epoch + 1, time_ns));
    for (unsigned i = 0; i < told.count; ++i) {
      ++ranges;
      const auto moment =
          module.moment_of(told.epoch, time_ns + std::int64_t{1000} * told.range[i].offset_us);
      if (!moment) {
        ++unknown;
        continue;
      }
      const auto after = sent[from].lower_bound(*moment);
      double apart_s = 1.0;
      if (after != sent[from].end()) apart_s = std::min(apart_s, to_seconds(*after - *moment));
      if (after != sent[from].begin()) apart_s = std::min(apart_s, to_seconds(*moment - *std::prev(after)));
      worst_s = std::max(worst_s, apart_s);
      oldest_s = std::max(oldest_s, to_seconds(room.world.events().now() - *moment));
    }
    return true;
  };
  for (std::uint16_t i = 1; i <= 3; ++i) room.add(i, on_circle(i, 3));
  room.run(20.0);  // over a wrap of the radio's time
  CHECK(ranges > 10'000);
  CHECK(unknown < ranges / 100);
  CHECK(worst_s < 5e-6);
  CHECK(oldest_s > 0.015 && oldest_s < 0.05);
}

}  // namespace

int main() {
  both_clocks_are_as_fast_as_is_said();
  a_radios_crystal_wanders_about_where_it_was_put();
  modules_differ_in_their_antenna_delays();
  the_moment_of_each_range_is_that_of_a_frame();
  return check::verdict();
}
