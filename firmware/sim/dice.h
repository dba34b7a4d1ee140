// Random numbers, and a source of them for anything that can be named by numbers: what happens to one thing
// does not depend on what else there is. Whole and uniform ones are the same on every machine; normal and
// exponential ones as far as its log1p and cos are, which may differ in the last bit.
#pragma once

#include <cmath>
#include <cstdint>
#include <initializer_list>

namespace air {

class Dice {
 public:
  Dice(std::initializer_list<std::uint64_t> name) {
    for (const std::uint64_t word : name) state_ = mix(state_ + kStep) ^ word;
  }

  // SplitMix64 (Steele, Lea, Flood 2014).
  std::uint64_t next() { return mix(state_ += kStep); }

  double uniform() { return static_cast<double>(next() >> 11) * 0x1p-53; }  // from 0 to below 1

  double normal() {  // mean 0, 1 sigma (Box and Muller)
    const double radius = std::sqrt(exponential() * 2.0);
    return radius * std::cos(2.0 * kPi * uniform());
  }

  double exponential() { return -std::log1p(-uniform()); }  // mean 1

 private:
  static constexpr std::uint64_t kStep = 0x9E3779B97F4A7C15;
  static constexpr double kPi = 3.14159265358979323846;

  static std::uint64_t mix(std::uint64_t x) {
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EB;
    return x ^ (x >> 31);
  }

  std::uint64_t state_ = 0;
};

}  // namespace air
