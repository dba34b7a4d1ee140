// Modules that range, sleep, wake and lose power for as long as is asked for: nobody gets stuck, nothing
// wrong is told.
//
//   test_life [HOURS]
#include <cstdlib>
#include <random>

#include "firmware/tests/sim/room.h"
#include "tests/cpp/check.h"

using namespace air;

namespace {

constexpr std::uint16_t kModules = 4;
constexpr double kPatienceS =
    4.0;  // so long two are awake together before they must have ranged in each second
constexpr double kNoiseM = 6 * 0.03;  // of a range, at most
constexpr double kLateM = 1.5;

// Power for ten minutes on average, then none for between 50 ms and half a minute.
std::vector<Module::Stint> power_cuts(std::mt19937_64& dice, double until_s) {
  std::vector<Module::Stint> stints;
  double t = std::uniform_real_distribution<double>(0.0, 5.0)(dice);
  while (t < until_s) {
    Module::Stint stint;
    stint.on = seconds(t);
    t += 1.0 + std::exponential_distribution<double>(1.0 / 600.0)(dice);
    stint.off = seconds(t);
    stint.temperature_c = std::uniform_real_distribution<double>(5.0, 45.0)(dice);
    stints.push_back(stint);
    t += std::exp(std::uniform_real_distribution<double>(std::log(0.05), std::log(30.0))(dice));
  }
  return stints;
}

// A blocked sight between 1 and 2 for ten seconds in each minute.
bool blocked(double t) { return std::fmod(t, 60.0) < 10.0; }

class Life {
 public:
  explicit Life(double until_s) : room_(settings()) {
    std::mt19937_64 dice(11);
    for (std::uint16_t i = 1; i <= kModules; ++i) {
      room_.add(i, resting(on_circle(i, kModules)), power_cuts(dice, until_s));
    }
    for (double t = 0.0; t < until_s; t += 60.0) {
      room_.world.medium().block(1, 2, seconds(t), seconds(t + 10.0), kLateM);
    }
  }

  void second() {
    now_s_ += 1.0;
    room_.run(now_s_);
    for (std::uint16_t i = 1; i <= kModules; ++i) watch(i);
    for (std::uint16_t i = 1; i <= kModules; ++i) {
      for (std::uint16_t j = static_cast<std::uint16_t>(i + 1); j <= kModules; ++j) {
        if (awake_s_[i] > kPatienceS && awake_s_[j] > kPatienceS) expect_ranges(i, j);
      }
    }
    for (const Told& one : room_.told) judge(one);
    room_.told.clear();
  }

  void end() {
    CHECK(static_cast<double>(pair_seconds_) > 0.05 * now_s_);
    CHECK_NEAR(static_cast<double>(room_.undecodable), 0.0, 0.0);
    for (const auto& [address, module] : room_.world.modules()) CHECK(module->chip().complaints().empty());
    std::cout << now_s_ / 3600.0 << " h, " << starts_ << " starts, " << ranges_ << " ranges, "
              << pair_seconds_ << " s of pairs awake together, " << silent_ << " of them silent; off by "
              << worst_m_ << " m at most, " << worst_late_m_ << " more than " << kLateM
              << " where late; clock off by " << worst_clock_s_ << " s\n";
  }

 private:
  static Room::Settings settings() {
    Room::Settings settings;
    settings.stamp_sigma_m = 0.0327;
    settings.frame_loss = 0.1;
    settings.range_s = 10;
    settings.sleep_s = 15;
    return settings;
  }

  void watch(std::uint16_t i) {
    const Module& module = room_.world.module(i);
    const bool ranges =
        module.board().powered() && !module.board().asleep() && module.node().state == NODE_RANGING;
    const bool same = module.starts() == seen_starts_[i];
    starts_ += module.starts() - seen_starts_[i];
    seen_starts_[i] = module.starts();
    awake_s_[i] = ranges && same ? awake_s_[i] + 1.0 : 0.0;
  }

  void expect_ranges(std::uint16_t i, std::uint16_t j) {
    ++pair_seconds_;
    if (!room_.between(i, j).empty()) return;
    ++silent_;
    std::cerr << "at " << now_s_ << " s: " << i << " and " << j << " have not ranged for a second\n";
    CHECK(false);
  }

  void judge(const Told& one) {
    ++ranges_;
    const bool between_1_and_2 = one.reporter + one.peer == 3;
    // A datagram waits up to 20 ms; a range's three frames are up to 20 ms apart.
    const bool begins = between_1_and_2 && blocked(one.at_s),
               ended = between_1_and_2 && blocked(one.at_s - 0.05);
    const double least_m = begins && ended ? kLateM - kNoiseM : -kNoiseM;
    const double most_m = begins || ended ? kLateM + kNoiseM : kNoiseM;
    CHECK(least_m <= one.error_m && one.error_m <= most_m);
    if (begins && ended) {
      worst_late_m_ = std::max(worst_late_m_, std::abs(one.error_m - kLateM));
    } else if (!begins && !ended) {
      worst_m_ = std::max(worst_m_, std::abs(one.error_m));
    }
    const auto [first, is_first] = epochs_.emplace(one.epoch, std::pair(one.at_s, one.clock_s));
    const double off_s = (one.clock_s - first->second.second) - (one.at_s - first->second.first);
    const double drift_s = 30e-6 * (one.at_s - first->second.first);  // a coordinator's crystal
    CHECK_NEAR(off_s, 0.0, 0.06 + drift_s);
    worst_clock_s_ = std::max(worst_clock_s_, std::abs(off_s) - drift_s);
  }

  Room room_;
  double now_s_ = 0.0;
  std::map<std::uint16_t, std::uint32_t> seen_starts_;
  std::map<std::uint16_t, double> awake_s_;
  std::map<std::uint32_t, std::pair<double, double>> epochs_;
  std::uint64_t starts_ = 0, ranges_ = 0, pair_seconds_ = 0, silent_ = 0;
  double worst_m_ = 0.0, worst_late_m_ = 0.0, worst_clock_s_ = 0.0;
};

}  // namespace

int main(int argc, char** argv) {
  const double until_s = 3600.0 * (argc > 1 ? std::atof(argv[1]) : 0.2);
  Life life(until_s);
  for (double t = 0.0; t < until_s; t += 1.0) life.second();
  life.end();
  return check::verdict();
}
