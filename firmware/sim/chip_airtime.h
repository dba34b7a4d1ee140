// How long the parts of a frame take on the air, in ticks of the radio's counter (UM 10, IEEE 802.15.4 UWB
// PHY). A chip of the modulation, 1 / 499.2 MHz, is 128 ticks.
#pragma once

#include <cstddef>
#include <cstdint>

#include "firmware/sim/time.h"

namespace air {

constexpr std::int64_t kTickHz = 128 * 499'200'000LL;

struct Phy {
  int kbps = 0;     // 110, 850 or 6800; 0: not a setting of the chip's
  int prf_mhz = 0;  // 16 or 64; 0 likewise
  int preamble_symbols = 0;
};

std::uint64_t symbol_ticks(const Phy& phy);  // of the preamble and the SFD
std::uint64_t preamble_ticks(const Phy& phy);
std::uint64_t sfd_ticks(const Phy& phy);
std::uint64_t header_ticks(const Phy& phy);
std::uint64_t data_ticks(const Phy& phy, std::size_t bytes);  // the FCS among them

// By a clock that is right.
constexpr Femto nominal_time(std::uint64_t ticks) { return static_cast<Femto>(ticks) * kSecond / kTickHz; }

}  // namespace air
