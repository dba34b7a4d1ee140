// The air that is steered while it runs: who is where and when, and how far time goes.
#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "firmware/targets/host/live.h"
#include "firmware/tests/sim/room.h"
#include "tests/cpp/check.h"

namespace {

using namespace air;

std::string hex_of(const Module::Key& key) {
  std::ostringstream text;
  for (const std::uint8_t byte : key) text << "0123456789abcdef"[byte >> 4] << "0123456789abcdef"[byte & 15];
  return text.str();
}

std::string module_line(std::uint16_t address) {
  return "module " + std::to_string(address) + ' ' + hex_of(key_of(address)) + " ppm " +
         std::to_string(10 - 5 * address) + " board_ppm 3 antenna_delay_error 0 temperature 23";
}

std::string at(std::uint16_t address, double t, double x) {
  std::ostringstream line;
  line << "at " << address << ' ' << t << ' ' << x << " 0 1";
  return line.str();
}

// Ranges are kept by the room; where each was in truth by the test.
struct Steered {
  explicit Steered(const std::vector<std::uint16_t>& addresses) : room({}), live(room.world) {
    for (const std::uint16_t address : addresses) live.take(module_line(address));
  }

  void take(const std::string& line) { live.take(line); }
  void run() { live.run_until(1000 * kSecond); }
  double now_s() { return room.now_s(); }
  std::size_t between(std::uint16_t a, std::uint16_t b, double from_s = 0.0, double to_s = 1e9) {
    return room.between(a, b, from_s, to_s).size();
  }

  Room room;
  Live live;
};

std::string fault(Steered& steered, const std::string& line) {
  try {
    steered.take(line);
  } catch (const std::invalid_argument& what) {
    return what.what();
  }
  return "";
}

void time_goes_to_the_newest_place_of_whoever_told_the_least() {
  Steered steered({1, 2, 3});
  steered.run();
  CHECK(!steered.live.horizon());
  steered.take(at(1, 0.0, 0.0));
  steered.take(at(1, 2.0, 0.0));
  steered.run();
  CHECK_NEAR(steered.now_s(), 1.999, 1e-9);  // a frame's length is left
  steered.take(at(2, 2.0, 1.0));
  steered.take(at(1, 9.0, 0.0));
  steered.run();
  CHECK_NEAR(steered.now_s(), 1.999, 1e-9);
  steered.take(at(2, 5.0, 1.0));
  steered.run();
  CHECK_NEAR(steered.now_s(), 4.999, 1e-9);
  CHECK(steered.between(1, 2) > 300);
  CHECK(steered.between(1, 2, 0.0, 2.0) == 0);
  CHECK(steered.room.undecodable == 0);
}

void who_has_no_place_yet_does_not_range_and_stops_nobody() {
  Steered steered({1, 2, 3});
  for (const double t : {0.0, 3.0})
    for (const std::uint16_t a : {std::uint16_t{1}, std::uint16_t{2}}) steered.take(at(a, t, a));
  steered.run();
  CHECK_NEAR(steered.now_s(), 2.999, 1e-9);
  CHECK(steered.room.world.modules().count(3) == 0);
  CHECK(steered.between(1, 2) > 300);
}

// 1 is at rest, 2 goes away from it by 1 m/s: a distance tells when it was measured.
void who_moves_is_where_the_lines_between_its_places_are() {
  Steered steered({1, 2});
  for (int k = 0; k <= 120; ++k) {
    const double t = k / 20.0;
    steered.take(at(1, t, 0.0));
    steered.take(at(2, t, 1.0 + t));
    steered.run();
  }
  double worst_m = 0.0, oldest_s = 0.0;
  const auto told = steered.room.between(1, 2, 1.0);
  CHECK(told.size() > 1000);
  for (const Told& one : told) {
    // As the room knows no tracks of these, its error is the distance itself.
    const double since_s = one.at_s - (one.range.distance_mm * 1e-3 - 1.0);
    oldest_s = std::max(oldest_s, since_s);
    worst_m = std::max(worst_m, -since_s);
  }
  CHECK(worst_m < 0.03);
  CHECK(oldest_s < 0.1);
}

// Others have gone on to 4 s when its first places come, of 3 s: it ranges from where it is by then.
void who_comes_late_never_ranges_from_a_place_of_before() {
  Steered steered({1, 2});
  for (int k = 0; k <= 80; ++k) steered.take(at(1, k / 20.0, 0.0));
  steered.run();
  for (int k = 0; k <= 60; ++k) {
    const double t = 3.0 + k / 20.0;
    steered.take(at(2, t, 1.0 + 2.0 * t));
    if (t > 4.0) steered.take(at(1, t, 0.0));
    steered.run();
    if (t < 4.0) CHECK(steered.room.world.modules().count(2) == 0);
  }
  const auto told = steered.room.between(1, 2);
  CHECK(told.size() > 300);
  for (const Told& one : told) {
    const double of_s = (one.range.distance_mm * 1e-3 - 1.0) / 2.0;
    CHECK(of_s > 3.99);
    CHECK(std::abs(one.at_s - of_s) < 0.1);
  }
}

void who_stays_is_not_waited_for_and_may_move_again() {
  Steered steered({1, 2});
  steered.take(at(1, 0.0, 0.0));
  steered.take(at(2, 0.0, 4.0));
  steered.take("stay 2");
  steered.take(at(1, 5.0, 0.0));
  steered.run();
  CHECK_NEAR(steered.now_s(), 4.999, 1e-9);
  for (const Told& one : steered.room.between(1, 2)) CHECK_NEAR(one.range.distance_mm, 4000.0, 30.0);
  steered.take(at(2, 4.9, 1.0));  // too late to be gone by
  steered.take(at(1, 6.0, 0.0));
  steered.run();
  CHECK_NEAR(steered.now_s(), 4.999, 1e-9);
  steered.take(at(2, 6.0, 6.0));
  steered.run();
  CHECK_NEAR(steered.now_s(), 5.999, 1e-9);
  const auto told = steered.room.between(1, 2, 5.9);
  CHECK(!told.empty());
  for (const Told& one : told) CHECK(one.range.distance_mm > 5500 && one.range.distance_mm < 6030);
}

void who_is_off_ranges_no_more_and_may_come_again() {
  Steered steered({1, 2, 3});
  for (const double t : {0.0, 2.0})
    for (std::uint16_t a = 1; a <= 3; ++a) steered.take(at(a, t, a));
  steered.run();
  CHECK(steered.between(1, 3, 1.0) > 100);
  steered.take("off 3");
  for (std::uint16_t a = 1; a <= 2; ++a) steered.take(at(a, 4.0, a));
  steered.run();
  CHECK_NEAR(steered.now_s(), 3.999, 1e-9);
  CHECK(steered.between(1, 3, 2.1) == 0);
  CHECK(steered.between(1, 2, 2.1) > 100);
  CHECK(fault(steered, "at 3 4 0 0 0") == "there is no module 3");
  steered.take(module_line(3));
  for (const double t : {5.0, 8.0})
    for (std::uint16_t a = 1; a <= 3; ++a) steered.take(at(a, t, 2.0 * a));
  steered.run();
  CHECK(steered.between(1, 3, 5.0) > 100);
  CHECK(steered.room.world.module(3).starts() == 2);
  for (const Told& one : steered.room.between(1, 3, 5.0)) CHECK_NEAR(one.range.distance_mm, 4000.0, 30.0);
}

void signals_come_late_where_that_is_said() {
  Steered steered({1, 2});
  steered.take("blocked 1 2 2 3 1.5");
  for (const double t : {0.0, 4.0})
    for (std::uint16_t a = 1; a <= 2; ++a) steered.take(at(a, t, 2.0 * a));
  steered.run();
  for (const Told& one : steered.room.between(1, 2, 2.1, 2.99))
    CHECK_NEAR(one.range.distance_mm, 3500.0, 60.0);
  for (const Told& one : steered.room.between(1, 2, 3.1)) CHECK_NEAR(one.range.distance_mm, 2000.0, 30.0);
}

void each_fault_is_told_and_changes_nothing() {
  Steered steered({1, 2});
  steered.take(at(1, 1.0, 0.0));
  const std::vector<std::pair<std::string, std::string>> faults = {
      {"", "what the line is about is missing"},
      {"walk 1", "'walk' is unknown"},
      {"module 3 00", "the key is not 64 hexadecimal digits"},
      {module_line(3) + " too", "'too' is too much"},
      {module_line(2), "module 2 is there already"},
      {"at 3 1 0 0 0", "there is no module 3"},
      {"at 1 1 0 0 0", "the times of module 1 must rise"},
      {"at 1 2 0 0", "a coordinate is missing"},
      {"at 1 2 0 0 nan", "a coordinate is nan, not from -1e+06 to 1e+06"},
      {"at 1 2e9 0 0 0", "the time is 2e9, not from 0 to 1e+09"},
      {"stay 2", "module 2 is nowhere yet"},
      {"stay 3", "there is no module 3"},
      {"off 1 2", "'2' is too much"},
      {"off 3", "there is no module 3"},
      {"blocked 1 1 0 1 2", "both ends are node 1"},
      {"blocked 1 2 1 1 2", "it ends before it begins"},
  };
  for (const auto& [line, words] : faults) {
    const std::string found = fault(steered, line);
    if (found != words) std::cerr << "'" << line << "': " << found << '\n';
    CHECK(found == words);
  }
  CHECK(to_seconds(*steered.live.horizon()) < 1.0);
  steered.take(at(1, 2.0, 0.0));
  steered.run();
  steered.take("off 1");
  std::string other = module_line(1);
  other[10] = 'f';
  CHECK(fault(steered, other) == "module 1 had another key before");
}

void places_of_before_are_forgotten() {
  Track track;
  for (int k = 0; k <= 10; ++k) track.add(k * kSecond, {static_cast<double>(k), 0.0, 0.0});
  track.forget_before(5 * kSecond + kSecond / 2);
  CHECK(track.oldest() == 5 * kSecond && track.newest() == 10 * kSecond);
  CHECK_NEAR(track.at(5 * kSecond + kSecond / 2)[0], 5.5, 1e-12);
  track.forget_before(99 * kSecond);
  CHECK_NEAR(track.at(0)[0], 10.0, 0.0);
}

}  // namespace

int main() {
  time_goes_to_the_newest_place_of_whoever_told_the_least();
  who_has_no_place_yet_does_not_range_and_stops_nobody();
  who_moves_is_where_the_lines_between_its_places_are();
  who_comes_late_never_ranges_from_a_place_of_before();
  who_stays_is_not_waited_for_and_may_move_again();
  who_is_off_ranges_no_more_and_may_come_again();
  signals_come_late_where_that_is_said();
  each_fault_is_told_and_changes_nothing();
  places_of_before_are_forgotten();
  return check::verdict();
}
