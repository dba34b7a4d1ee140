#include "firmware/sim/module.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <utility>

#include "firmware/sim/chip_airtime.h"
#include "firmware/sim/chip_bits.h"

namespace air {

namespace {

// Of sending and receiving together; Decawave's own value for its boards at PRF 64 MHz (514.4625 ns), at 23
// degrees. Modules differ by 30 cm, 3 sigma (APS014), of a range.
constexpr std::int64_t kTypicalDelay = 32873;
constexpr double kDelaySpreadM = 0.1;
constexpr double kCalibratedAtC = 23.0;
constexpr double kMetresPerDegree = 2.15e-3;  // of a range, by each of the two modules (APS014)

// A crystal wanders about where it was put: 0.01 ppm in a second, and back within some minutes. So much is
// seen from draughts and from a module's own warmth where the crystal is a plain one (assumed).
constexpr double kWanderPpm = 0.01;
constexpr double kBackAfterS = 300.0;
constexpr Femto kWanderEvery = 100 * kMillisecond;

// What half a range's length takes to come twice as late: a change of a delay counts half in each range.
Femto delay_of_range(double range_m) { return seconds(2.0 * range_m / kSpeedOfLight); }

Femto of_ticks(std::int64_t ticks) { return static_cast<Femto>(ticks) * kSecond / kTickHz; }

// What dice say of one module; each use has a number of its own.
enum class Use : std::uint64_t { kDelay = 1, kChip, kBoard, kWander };

Dice dice_for(std::uint64_t seed, std::uint16_t address, Use use) {
  return Dice{seed, address, static_cast<std::uint64_t>(use)};
}

std::int64_t drawn_delay(std::uint64_t seed, std::uint16_t address) {
  const double off_m = kDelaySpreadM * dice_for(seed, address, Use::kDelay).normal();
  return kTypicalDelay + std::llround(to_seconds(delay_of_range(off_m)) * static_cast<double>(kTickHz));
}

Chip::Nature nature_of(std::uint64_t seed, std::uint16_t address) {
  Chip::Nature nature;
  nature.seed = dice_for(seed, address, Use::kChip).next();
  return nature;
}

}  // namespace

Module::Module(Events& events, Medium& medium, std::uint64_t seed, const struct node_settings& common,
               Spec spec)
    : events_(events),
      spec_(std::move(spec)),
      track_(spec_.track),
      nominal_delay_(drawn_delay(seed, spec_.address)),
      dice_(dice_for(seed, spec_.address, Use::kWander)),
      chip_(events, medium, nature_of(seed, spec_.address)),
      board_(events, chip_, dice_for(seed, spec_.address, Use::kBoard).next(),
             [this](Board&, bool slept) { return run(slept); }),
      settings_(common) {
  settings_.address = spec_.address;
  std::copy(spec_.key.begin(), spec_.key.end(), settings_.key);
  settings_.eui64 = UINT64_C(0xACDE480000000000) | spec_.address;
  settings_.calibration.antenna_delay = static_cast<std::uint32_t>(nominal_delay_);
  settings_.calibration.temperature_cc = static_cast<std::int16_t>(kCalibratedAtC * 100.0);
  medium.add(spec_.address, chip_, track_);
  board_.on_wait = [this] { tell_state(); };
  for (const Stint& stint : spec_.stints) {
    events_.at(stint.on, [this, &stint] { begin(stint); });
    if (stint.off < kForever) events_.at(stint.off, [this] { end(); });
  }
}

void Module::begin(const Stint& stint) {
  stint_ = stint;
  const double warmer_c = stint.temperature_c - kCalibratedAtC;
  const Femto delay =
      of_ticks(nominal_delay_) + delay_of_range(stint.antenna_delay_error_m + kMetresPerDegree * warmer_c);
  chip_.set_delays(delay / 2, delay - delay / 2);  // two-way ranging sees only the sum
  chip_.set_temperature(stint.temperature_c);
  board_.power_on(stint.board_ppm);
  wander();
}

void Module::end() {
  board_.power_off();
  events_.cancel(wanders_next_);
}

void Module::wander() {
  if (!board_.asleep()) {
    // Ornstein and Uhlenbeck's process, exact over any time.
    const double elapsed_s = to_seconds(events_.now() - wandered_at_);
    const double kept = std::exp(-elapsed_s / kBackAfterS);
    const double spread_ppm = kWanderPpm * std::sqrt(0.5 * kBackAfterS * (1.0 - kept * kept));
    wandered_ppm_ = kept * wandered_ppm_ + spread_ppm * dice_.normal();
    wandered_at_ = events_.now();
    chip_.crystal().turn(events_.now(), stint_.ppm + wandered_ppm_);
  }
  wanders_next_ = events_.at(events_.now() + kWanderEvery, [this] { wander(); });
}

std::uint64_t Module::run(bool slept) {
  // Memory is garbage after a start: a node that does not begin all of its state shall fail in the tests, not
  // on a board.
  std::memset(&node_, 0xC5, sizeof node_);
  settings_.restarts = starts_++;
  std::uint64_t deadline_us = node_start(&node_, board_.hal(), &settings_, slept);
  while (node_.state != NODE_ASLEEP) {
    board_.wait_for_interrupt(deadline_us);
    std::array<std::uint8_t, WIRE_MAX_SIZE> datagram;
    const std::size_t size = board_.receive(datagram.data(), datagram.size());
    if (size > 0) (void)node_hear(&node_, datagram.data(), size);
    deadline_us = node_run(&node_);
  }
  return deadline_us;
}

std::optional<Femto> Module::moment_of(std::uint32_t epoch, std::int64_t time_ns) const {
  const struct ranging& ranging = node_.ranging;
  if (!board_.powered() || board_.asleep() || ranging.epoch != epoch) return std::nullopt;
  constexpr auto kHalf = static_cast<std::int64_t>(kCounterMask / 2 + 1);
  const std::uint64_t ticks = chip_.crystal().ticks(events_.now());
  const std::int64_t since =
      static_cast<std::int64_t>((ticks - ranging.epoch_ticks + kHalf) & kCounterMask) - kHalf;
  constexpr Femto kNanosecond = kMicrosecond / 1000;
  const Femto age = (static_cast<Femto>(ranging.epoch_ns) - time_ns) * kNanosecond + of_ticks(since);
  return events_.now() - age;
}

std::string_view Module::state() const {
  if (!board_.powered()) return "has no power";
  if (board_.asleep()) return "sleeps";
  switch (node_.state) {
    case NODE_SILENT:
      return "finds no radio";
    case NODE_LEAVING:
      return "leaves";
    case NODE_ASLEEP:
      return "falls asleep";
    case NODE_RANGING:
      break;
  }
  switch (node_.ranging.state) {
    case RANGING_DISCOVERING:
      return "looks for others";
    case RANGING_JOINING:
      return "asks to join";
    case RANGING_MEMBER:
      return "is a member";
    case RANGING_COORDINATING:
      return "coordinates";
    case RANGING_LEFT:
      return "has left";
  }
  return "is lost";
}

void Module::tell_state() {
  if (state() == told_) return;
  told_ = state();
  if (on_state) on_state(told_);
}

}  // namespace air
