// What passes between a radio's model and the medium.
#pragma once

#include <cstdint>
#include <vector>

#include "firmware/sim/time.h"

namespace air {

struct Emission {
  std::vector<std::uint8_t> bytes;  // with the FCS
  int channel = 0, prf_mhz = 0, preamble_code = 0;
  // When the preamble begins, the first bit of the PHR (the RMARKER, which is what is stamped) is, and the
  // last symbol ends at the antenna.
  Femto begin = 0, marker = 0, end = 0;
  double ppm = 0.0;  // of the sender's crystal
  int kbps = 6800, preamble_symbols = 128;
};

// An emission as it comes to one antenna: times are those of arrival along the straight line.
struct Arrival {
  Emission emission;
  double rx_power_dbm = 0.0;  // in all
  double fp_power_dbm = 0.0;  // of the first path
  Femto stamp_error =
      0;  // by how much later than the straight line's RMARKER the radio takes it: noise, bias, detour
  bool unnoticed = false;  // its preamble is not found, but what else comes in is disturbed by it
};

class Chip;

class Ether {
 public:
  virtual ~Ether() = default;
  // Called when the preamble begins.
  virtual void send(Chip& from, const Emission& emission) = 0;
};

}  // namespace air
