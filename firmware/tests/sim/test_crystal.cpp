// Counting of a crystal that is off and drifts.
#include <random>
#include <stdexcept>

#include "firmware/sim/crystal.h"
#include "tests/cpp/check.h"

namespace {

using air::Crystal;
using air::Femto;
using air::kMicrosecond;
using air::kSecond;

constexpr double kRadioHz = 63'897'600'000.0;

void a_perfect_crystal_counts_its_frequency() {
  const Crystal radio(kRadioHz, 0.0);
  CHECK(radio.ticks(kSecond) == 63'897'600'000);
  CHECK(radio.ticks(kSecond - 1) == 63'897'599'999);
  CHECK(radio.ticks(86'400 * kSecond) == 86'400 * 63'897'600'000);
  const Crystal board(1e6, 0.0, 5 * kSecond);
  CHECK(board.ticks(5 * kSecond) == 0);
  CHECK(board.ticks(5 * kSecond + kMicrosecond) == 1);
  CHECK(board.ticks(5 * kSecond + kMicrosecond - 1) == 0);
  CHECK(board.ticks(100'005 * kSecond) == 100'000'000'000);
}

void parts_per_million_are_what_they_say() {
  CHECK(Crystal(1e6, 20.0).ticks(kSecond) == 1'000'020);
  CHECK(Crystal(1e6, -20.0).ticks(kSecond) == 999'980);
  CHECK(Crystal(kRadioHz, 1.0).ticks(kSecond) == 63'897'600'000 + 63'897);
}

void when_is_the_first_moment_of_its_tick_over_turns_and_days() {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> ppm(-25.0, 25.0), wait(0.0, 40'000.0);
  for (const double hz : {kRadioHz, 1e6, 32'768.0}) {
    Crystal crystal(hz, ppm(random), 3);
    Femto turned = 3;
    for (int turns = 0; turns < 50; ++turns) {
      const std::uint64_t at_turn = crystal.ticks(turned);
      for (int i = 0; i < 50; ++i) {
        const std::uint64_t tick = crystal.ticks(turned + air::seconds(wait(random))) + random() % 3;
        if (tick <= at_turn) continue;
        const Femto t = crystal.when(tick);
        CHECK(crystal.ticks(t) == tick);
        CHECK(crystal.ticks(t - 1) == tick - 1);
      }
      CHECK(crystal.when(at_turn) == turned);
      turned += air::seconds(wait(random));
      crystal.turn(turned, ppm(random));
    }
  }
}

// The same by fractions of seconds that add up exactly: 1 MHz at whole ppm for whole seconds.
void nothing_is_lost_when_it_turns() {
  Crystal crystal(1e6, 0.0);
  std::uint64_t expected = 0;
  for (int second = 0; second < 1000; ++second) {
    const int ppm = second % 41 - 20;
    crystal.turn(second * kSecond, ppm);
    expected += 1'000'000 + static_cast<std::uint64_t>(ppm + 20);
  }
  CHECK(crystal.ticks(1000 * kSecond) == expected - std::uint64_t{20'000});

  Crystal turned(kRadioHz, 7.3);
  const Crystal steady(kRadioHz, 7.3);
  for (int i = 1; i < 10'000; ++i) turned.turn(i * Femto{123'456'789'012'345}, 7.3);
  for (int i = 0; i < 100; ++i) {
    const Femto t = 10'000 * Femto{123'456'789'012'345} + i * Femto{1'234};
    CHECK(turned.ticks(t) == steady.ticks(t));
  }
}

void the_past_is_not_asked_for() {
  Crystal crystal(1e6, 0.0);
  crystal.turn(kSecond, 1.0);
  bool thrown = false;
  try {
    crystal.turn(kSecond - 1, 0.0);
  } catch (const std::logic_error&) {
    thrown = true;
  }
  CHECK(thrown);
  CHECK_NEAR(crystal.ppm(), 1.0, 0.0);
}

}  // namespace

int main() {
  a_perfect_crystal_counts_its_frequency();
  parts_per_million_are_what_they_say();
  when_is_the_first_moment_of_its_tick_over_turns_and_days();
  nothing_is_lost_when_it_turns();
  the_past_is_not_asked_for();
  return check::verdict();
}
