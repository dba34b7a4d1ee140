#include "firmware/sim/medium.h"

#include <algorithm>
#include <iterator>
#include <stdexcept>

#include "firmware/sim/dice.h"
#include "firmware/sim/propagation.h"

namespace air {

namespace {

// As in the walks that are simulated without modules (synchronizar/simulation/radios.py).
constexpr double kShadowingDb = 1.0;
// Received power in all minus that of the first path, mean and 1 sigma: in line of sight, and late.
constexpr double kClearLossDb = 3.0, kClearLossSigmaDb = 1.5;
constexpr double kLateLossDb = 12.0, kLateLossSigmaDb = 3.0;

// Of the frames that are lost so many come in with a wrong octet; of the others the receiver notices nothing.
constexpr double kGarbledShare = 0.5;

Femto light_time(double length_m) { return seconds(length_m / kSpeedOfLight); }

std::pair<std::uint16_t, std::uint16_t> pair_of(std::uint16_t a, std::uint16_t b) {
  return std::minmax({a, b});
}

}  // namespace

void Medium::add(std::uint16_t address, Chip& chip, const Track& track) {
  for (const Antenna& other : antennas_)
    if (other.address == address) throw std::invalid_argument("two antennas have one address");
  antennas_.push_back({address, &chip, &track, 0});
}

void Medium::block(std::uint16_t a, std::uint16_t b, Femto begin, Femto end, double extra_m) {
  Spans& spans = blocked_[pair_of(a, b)];
  const auto after = spans.lower_bound(begin);
  if (end <= begin || (after != spans.end() && after->first < end) ||
      (after != spans.begin() && std::prev(after)->second.end > begin))
    throw std::invalid_argument("a span in which signals come late is empty, or overlaps another");
  spans[begin] = {end, extra_m};
}

void Medium::forget_before(Femto t) {
  for (auto& [pair, spans] : blocked_)
    for (auto span = spans.begin(); span != spans.end();)
      span = span->second.end < t ? spans.erase(span) : std::next(span);
}

void Medium::send(Chip& chip, const Emission& emission) {
  const auto from = std::find_if(antennas_.begin(), antennas_.end(),
                                 [&](const Antenna& antenna) { return antenna.chip == &chip; });
  if (from == antennas_.end()) throw std::logic_error("a radio without an antenna sends");
  ++from->sent;
  if (on_emission) on_emission(from->address, emission);
  for (const Antenna& to : antennas_) {
    if (&to == &*from) continue;
    Passage passage = pass(*from, to, emission);
    if (on_passage) on_passage(passage);
    const Femto begin = passage.arrival.emission.begin;
    events_.at(begin, [hearer = to.chip, arrival = std::move(passage.arrival)] { hearer->hear(arrival); });
  }
}

Passage Medium::pass(const Antenna& from, const Antenna& to, const Emission& emission) const {
  // What happens to one frame on its way to one receiver depends on nothing else.
  Dice dice{settings_.seed, from.address, to.address, from.sent};
  Passage passage;
  passage.from = from.address;
  passage.to = to.address;
  passage.distance_m = distance(from.track->at(emission.marker), to.track->at(emission.marker));
  passage.noise_m = settings_.stamp_sigma_m * dice.normal();
  const Span* const span = blocked(from.address, to.address, emission.marker);
  passage.late = span != nullptr;
  passage.detour_m = passage.late ? span->extra_m : 0.0;

  Arrival& arrival = passage.arrival;
  arrival.emission = emission;
  const Femto delay = light_time(passage.distance_m);
  arrival.emission.begin += delay;
  arrival.emission.marker += delay;
  arrival.emission.end += delay;
  arrival.rx_power_dbm =
      received_power_dbm(emission.channel, passage.distance_m) + kShadowingDb * dice.normal();
  arrival.fp_power_dbm =
      arrival.rx_power_dbm - (passage.late ? kLateLossDb + kLateLossSigmaDb * dice.normal()
                                           : kClearLossDb + kClearLossSigmaDb * dice.normal());
  passage.bias_m = power_bias_m(emission.channel, emission.prf_mhz, arrival.rx_power_dbm);
  arrival.stamp_error = light_time(passage.noise_m + passage.bias_m + passage.detour_m);

  if (dice.uniform() < settings_.frame_loss) {
    const bool garbled = dice.uniform() < kGarbledShare;
    passage.fate = garbled ? Passage::Fate::kGarbled : Passage::Fate::kUnnoticed;
    arrival.unnoticed = !garbled;
    std::vector<std::uint8_t>& bytes = arrival.emission.bytes;
    if (garbled) bytes[dice.next() % bytes.size()] ^= static_cast<std::uint8_t>(1 + dice.next() % 255);
  }
  return passage;
}

const Medium::Span* Medium::blocked(std::uint16_t a, std::uint16_t b, Femto t) const {
  const auto spans = blocked_.find(pair_of(a, b));
  if (spans == blocked_.end()) return nullptr;
  const auto after = spans->second.upper_bound(t);
  if (after == spans->second.begin()) return nullptr;
  const Span& latest = std::prev(after)->second;
  return t < latest.end ? &latest : nullptr;
}

}  // namespace air
