// A node's oscillator: it is off by some parts per million, and that changes. All arithmetic is in integers:
// a rate is a whole number of micro-hertz, and nothing is rounded beyond that, whatever the time.
#pragma once

#include <cstdint>

#include "firmware/sim/time.h"

namespace air {

class Crystal {
 public:
  // Counts from `begin` on at `nominal_hz` (1 + 1e-6 ppm).
  Crystal(double nominal_hz, double ppm, Femto begin = 0);

  // From t on; not before a turn made already.
  void turn(Femto t, double ppm);

  double ppm() const { return ppm_; }
  std::uint64_t ticks(Femto t) const;  // whole ones counted since begin, t not before the latest turn
  Femto when(
      std::uint64_t ticks) const;  // first moment at which so many are counted, not before the latest turn

 private:
  void set_rate(double ppm);

  double nominal_hz_, ppm_ = 0.0;
  Femto rate_ = 0;  // micro-hertz
  Femto turned_;
  Femto micros_ = 0;  // millionths of a tick counted when it turned, and
  Femto part_ = 0;    // 1e-15 of those besides
};

}  // namespace air
