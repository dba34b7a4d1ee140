#include "firmware/sim/crystal.h"

#include <cmath>
#include <stdexcept>

namespace air {

namespace {

constexpr Femto kMicrosPerTick = 1'000'000;

}  // namespace

Crystal::Crystal(double nominal_hz, double ppm, Femto begin) : nominal_hz_(nominal_hz), turned_(begin) {
  set_rate(ppm);
}

void Crystal::set_rate(double ppm) {
  ppm_ = ppm;
  rate_ = std::llround(nominal_hz_ * (1e6 + ppm));
  if (rate_ <= 0) throw std::invalid_argument("a crystal that does not go forward");
}

void Crystal::turn(Femto t, double ppm) {
  if (t < turned_) throw std::logic_error("a crystal was to turn in the past");
  // Seconds apart from the rest: the product of a long time and the rate would not fit.
  const Femto elapsed = t - turned_;
  const Femto more = part_ + elapsed % kSecond * rate_;
  micros_ += elapsed / kSecond * rate_ + more / kSecond;
  part_ = more % kSecond;
  turned_ = t;
  set_rate(ppm);
}

std::uint64_t Crystal::ticks(Femto t) const {
  if (t < turned_) throw std::logic_error("a crystal was asked for the past");
  const Femto elapsed = t - turned_;
  const Femto micros = micros_ + elapsed / kSecond * rate_ + (part_ + elapsed % kSecond * rate_) / kSecond;
  return static_cast<std::uint64_t>(micros / kMicrosPerTick);
}

Femto Crystal::when(std::uint64_t ticks) const {
  const Femto missing = static_cast<Femto>(ticks) * kMicrosPerTick - micros_;
  if (missing <= 0) return turned_;
  const Femto rest = missing % rate_ * kSecond - part_;  // 1e-15 micros; below 0 by less than one of those
  return turned_ + missing / rate_ * kSecond + (rest > 0 ? (rest + rate_ - 1) / rate_ : -(-rest / rate_));
}

}  // namespace air
