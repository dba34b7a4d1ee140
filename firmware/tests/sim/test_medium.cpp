// The air: when and how strong a frame comes in, how wrong its stamp is, which are lost.
#include <cmath>
#include <memory>
#include <stdexcept>
#include <vector>

#include "firmware/sim/chip.h"
#include "firmware/sim/dice.h"
#include "firmware/sim/events.h"
#include "firmware/sim/medium.h"
#include "firmware/sim/propagation.h"
#include "firmware/sim/track.h"
#include "tests/cpp/check.h"

namespace {

using air::Femto;
using air::kMicrosecond;
using air::kMillisecond;
using air::kSecond;
using Fate = air::Passage::Fate;

air::Track at_rest(double x) {
  air::Track track;
  track.add(0, {x, 0.0, 0.0});
  return track;
}

air::Emission emission_at(Femto marker) {
  air::Emission emission;
  emission.bytes = {1, 2, 3, 4, 5, 6, 7, 8};
  emission.channel = 5;
  emission.prf_mhz = 64;
  emission.begin = marker - 138 * kMicrosecond;
  emission.marker = marker;
  emission.end = marker + 40 * kMicrosecond;
  return emission;
}

// Radios without power at given places on a line; what the medium does to their frames is written down.
struct Room {
  explicit Room(const air::Medium::Settings& settings, const std::vector<double>& places)
      : medium(events, settings) {
    for (const double x : places) tracks.push_back(at_rest(x));
    for (std::size_t i = 0; i < tracks.size(); ++i) {
      chips.push_back(std::make_unique<air::Chip>(events, medium, air::Chip::Nature{}));
      medium.add(static_cast<std::uint16_t>(i + 1), *chips[i], tracks[i]);
    }
    medium.on_passage = [this](const air::Passage& passage) { passages.push_back(passage); };
  }

  void send(std::size_t from, Femto marker) { medium.send(*chips[from], emission_at(marker)); }

  air::Events events;
  air::Medium medium;
  std::vector<air::Track> tracks;
  std::vector<std::unique_ptr<air::Chip>> chips;
  std::vector<air::Passage> passages;
};

struct Moments {
  double mean, sigma;
};

template <typename Value>
Moments moments(const std::vector<air::Passage>& passages, Value value) {
  const auto n = static_cast<double>(passages.size());
  double sum = 0.0, squares = 0.0;
  for (const air::Passage& passage : passages) sum += value(passage);
  for (const air::Passage& passage : passages) squares += std::pow(value(passage) - sum / n, 2);
  return {sum / n, std::sqrt(squares / n)};
}

// 30 m of light are 100.0692 ns.
void a_frame_comes_in_later_by_the_time_that_light_takes() {
  Room room({}, {0.0, 30.0, -30.0});
  room.send(0, kSecond);
  CHECK(room.passages.size() == 2);
  for (const air::Passage& passage : room.passages) {
    CHECK_NEAR(passage.distance_m, 30.0, 1e-12);
    const air::Emission& came = passage.arrival.emission;
    CHECK_NEAR(static_cast<double>(came.marker - kSecond), 100'069'228.6, 1.0);
    CHECK(came.marker - came.begin == 138 * kMicrosecond);
    CHECK(came.end - came.marker == 40 * kMicrosecond);
  }
}

void a_frame_is_heard_where_the_antenna_is_at_that_moment() {
  air::Track track;
  track.add(kSecond, {0.0, 0.0, 0.0});
  track.add(3 * kSecond, {4.0, 2.0, -6.0});
  track.add(4 * kSecond, {4.0, 2.0, -6.5});
  CHECK_NEAR(track.at(0)[0], 0.0, 0.0);
  CHECK_NEAR(track.at(kSecond + kSecond / 2)[0], 1.0, 1e-12);
  CHECK_NEAR(track.at(kSecond + kSecond / 2)[1], 0.5, 1e-12);
  CHECK_NEAR(track.at(kSecond + kSecond / 2)[2], -1.5, 1e-12);
  CHECK_NEAR(track.at(3 * kSecond)[2], -6.0, 1e-12);
  CHECK_NEAR(track.at(86400 * kSecond)[2], -6.5, 0.0);
}

// Channel 5: -14.31 dBm leave, 20 log10(4 pi 6489.6 MHz / c) = 48.69 dB are lost over the first metre, 20
// over each further decade.
void power_falls_as_friis_says() {
  CHECK_NEAR(air::received_power_dbm(5, 1.0), -63.00, 0.01);
  CHECK_NEAR(air::received_power_dbm(5, 10.0), -83.00, 0.01);
  CHECK_NEAR(air::received_power_dbm(5, 2.0), -69.02, 0.01);
  CHECK_NEAR(air::received_power_dbm(2, 1.0), -58.78, 0.01);  // 3993.6 MHz: 44.47 dB
  CHECK(std::isfinite(air::received_power_dbm(5, 0.0)));
}

void the_bias_of_nature_goes_through_the_points_of_aps011() {
  CHECK_NEAR(air::power_bias_m(5, 64, -61.0), -0.110, 1e-9);
  CHECK_NEAR(air::power_bias_m(5, 64, -77.0), 0.0, 1e-9);
  CHECK_NEAR(air::power_bias_m(5, 64, -78.0), 0.0105, 1e-9);
  CHECK_NEAR(air::power_bias_m(5, 64, -93.0), 0.081, 1e-9);
  CHECK_NEAR(air::power_bias_m(5, 64, -40.0), -0.110, 1e-9);
  CHECK_NEAR(air::power_bias_m(5, 64, -120.0), 0.081, 1e-9);
  CHECK_NEAR(air::power_bias_m(5, 16, -61.0), 0.0, 0.0);
  for (const int wide : {4, 7}) CHECK_NEAR(air::power_bias_m(wide, 64, -61.0), 0.0, 0.0);
}

void a_stamp_is_wrong_by_noise_and_bias() {
  Room room({1, 0.03, 0.0}, {0.0, 5.0});
  for (int i = 0; i < 20000; ++i) room.send(0, kSecond + i * kMillisecond);
  const Moments noise = moments(room.passages, [](const auto& p) { return p.noise_m; });
  CHECK_NEAR(noise.mean, 0.0, 4 * 0.03 / std::sqrt(20000.0));
  CHECK_NEAR(noise.sigma, 0.03, 0.001);
  const Moments power = moments(room.passages, [](const auto& p) { return p.arrival.rx_power_dbm; });
  CHECK_NEAR(power.mean, -63.0 - 20.0 * std::log10(5.0), 0.05);
  CHECK_NEAR(power.sigma, 1.0, 0.03);  // shadowing
  for (const air::Passage& p : room.passages) {
    CHECK_NEAR(p.bias_m, air::power_bias_m(5, 64, p.arrival.rx_power_dbm), 1e-12);
    CHECK_NEAR(static_cast<double>(p.arrival.stamp_error) * 1e-15 * 299'792'458.0, p.noise_m + p.bias_m,
               1e-6);
  }
}

void so_many_frames_are_lost_as_is_asked_for() {
  Room room({2, 0.0, 0.3}, {0.0, 5.0});
  const int n = 20000;
  for (int i = 0; i < n; ++i) room.send(0, kSecond + i * kMillisecond);
  int garbled = 0, unnoticed = 0;
  for (const air::Passage& p : room.passages) {
    garbled += p.fate == Fate::kGarbled ? 1 : 0;
    unnoticed += p.fate == Fate::kUnnoticed ? 1 : 0;
    CHECK((p.arrival.emission.bytes != emission_at(0).bytes) == (p.fate == Fate::kGarbled));
    CHECK(p.arrival.unnoticed == (p.fate == Fate::kUnnoticed));
  }
  const double sigma = std::sqrt(n * 0.3 * 0.7);
  CHECK_NEAR(garbled + unnoticed, 0.3 * n, 4 * sigma);
  CHECK_NEAR(garbled, 0.15 * n, 4 * sigma);
}

void none_are_lost_where_none_shall_be_and_all_where_all() {
  for (const double loss : {0.0, 1.0}) {
    Room room({3, 0.0, loss}, {0.0, 5.0});
    for (int i = 0; i < 1000; ++i) room.send(0, kSecond + i * kMillisecond);
    for (const air::Passage& p : room.passages) CHECK((p.fate == Fate::kCame) == (loss == 0.0));
  }
}

void signals_are_late_within_the_spans_and_between_the_two_alone() {
  Room room({4, 0.0, 0.0}, {0.0, 5.0, 10.0});
  room.medium.block(2, 1, 2 * kSecond, 3 * kSecond, 1.25);
  room.medium.block(2, 1, 3 * kSecond, 4 * kSecond, 0.5);
  const auto detour = [&room](std::size_t from, std::uint16_t to, Femto marker) {
    room.passages.clear();
    room.send(from, marker);
    for (const air::Passage& p : room.passages) {
      const double wrong_m = static_cast<double>(p.arrival.stamp_error) * 1e-15 * 299'792'458.0;
      CHECK_NEAR(wrong_m, p.bias_m + p.detour_m, 1e-6);
      if (p.to == to) return p.detour_m;
    }
    return -1.0;
  };
  CHECK_NEAR(detour(0, 2, 2 * kSecond - 1), 0.0, 0.0);
  CHECK_NEAR(detour(0, 2, 2 * kSecond), 1.25, 0.0);
  CHECK_NEAR(detour(1, 1, 3 * kSecond - 1), 1.25, 0.0);
  CHECK_NEAR(detour(1, 1, 3 * kSecond), 0.5, 0.0);
  CHECK_NEAR(detour(1, 1, 4 * kSecond), 0.0, 0.0);
  CHECK_NEAR(detour(0, 3, 2 * kSecond), 0.0, 0.0);
  CHECK_NEAR(detour(2, 2, 2 * kSecond), 0.0, 0.0);
}

void the_first_path_of_late_signals_is_weak() {
  Room room({5, 0.0, 0.0}, {0.0, 5.0});
  room.medium.block(1, 2, 10 * kSecond, 20 * kSecond, 1.0);
  const auto weaker = [](const air::Passage& p) { return p.arrival.rx_power_dbm - p.arrival.fp_power_dbm; };
  for (int i = 0; i < 5000; ++i) room.send(0, kSecond + i * kMillisecond);
  const Moments clear = moments(room.passages, weaker);
  CHECK_NEAR(clear.mean, 3.0, 0.1);
  CHECK_NEAR(clear.sigma, 1.5, 0.1);
  room.passages.clear();
  for (int i = 0; i < 5000; ++i) room.send(0, 11 * kSecond + i * kMillisecond);
  const Moments late = moments(room.passages, weaker);
  CHECK_NEAR(late.mean, 12.0, 0.2);
  CHECK_NEAR(late.sigma, 3.0, 0.2);
}

void spans_that_overlap_are_refused() {
  Room room({}, {0.0, 5.0});
  room.medium.block(1, 2, 2 * kSecond, 3 * kSecond, 1.0);
  const auto refused = [&room](Femto begin, Femto end) {
    try {
      room.medium.block(2, 1, begin, end, 1.0);
    } catch (const std::invalid_argument&) {
      return true;
    }
    return false;
  };
  CHECK(refused(kSecond, 2 * kSecond + 1));
  CHECK(refused(3 * kSecond - 1, 4 * kSecond));
  CHECK(refused(2 * kSecond + 1, 2 * kSecond + 2));
  CHECK(refused(kSecond, 4 * kSecond));
  CHECK(refused(5 * kSecond, 5 * kSecond));
  CHECK(!refused(3 * kSecond, 4 * kSecond));
  CHECK(!refused(kSecond, 2 * kSecond));
}

void what_happens_to_a_frame_does_not_depend_on_who_else_is_there() {
  Room two({6, 0.03, 0.2}, {0.0, 5.0});
  Room three({6, 0.03, 0.2}, {0.0, 5.0, 8.0});
  Room other_seed({7, 0.03, 0.2}, {0.0, 5.0});
  int differ = 0;
  for (int i = 0; i < 100; ++i) {
    const Femto t = kSecond + i * kMillisecond;
    two.send(0, t);
    three.send(2, t);
    three.passages.clear();
    three.send(0, t);
    other_seed.send(0, t);
    const air::Passage &a = two.passages.back(), &b = three.passages.front(), &c = other_seed.passages.back();
    CHECK(a.arrival.stamp_error == b.arrival.stamp_error);
    CHECK(a.fate == b.fate);
    differ += a.arrival.stamp_error != c.arrival.stamp_error ? 1 : 0;
  }
  CHECK_NEAR(differ, 100, 0);
}

void dice_are_fair() {
  air::Dice dice{1, 2, 3};
  const int n = 100000;
  double uniform = 0.0, normal = 0.0, squares = 0.0, tails = 0.0, exponential = 0.0;
  for (int i = 0; i < n; ++i) {
    const double u = dice.uniform(), z = dice.normal();
    CHECK(0.0 <= u && u < 1.0);
    uniform += u / n;
    normal += z / n;
    squares += z * z / n;
    tails += std::abs(z) > 1.96 ? 1.0 / n : 0.0;
    exponential += dice.exponential() / n;
  }
  CHECK_NEAR(uniform, 0.5, 0.005);
  CHECK_NEAR(normal, 0.0, 0.015);
  CHECK_NEAR(squares, 1.0, 0.02);
  CHECK_NEAR(tails, 0.05, 0.003);
  CHECK_NEAR(exponential, 1.0, 0.015);
}

}  // namespace

int main() {
  a_frame_comes_in_later_by_the_time_that_light_takes();
  a_frame_is_heard_where_the_antenna_is_at_that_moment();
  power_falls_as_friis_says();
  the_bias_of_nature_goes_through_the_points_of_aps011();
  a_stamp_is_wrong_by_noise_and_bias();
  so_many_frames_are_lost_as_is_asked_for();
  none_are_lost_where_none_shall_be_and_all_where_all();
  signals_are_late_within_the_spans_and_between_the_two_alone();
  the_first_path_of_late_signals_is_weak();
  spans_that_overlap_are_refused();
  what_happens_to_a_frame_does_not_depend_on_who_else_is_there();
  dice_are_fair();
  return check::verdict();
}
