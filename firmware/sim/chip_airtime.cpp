#include "firmware/sim/chip_airtime.h"

namespace air {

namespace {

constexpr std::uint64_t kTicksPerChip = 128;

// Length of the codes times the chips between pulses (UM table 60): 127 x 4 and 31 x 16.
constexpr std::uint64_t kSymbolChips64 = 508, kSymbolChips16 = 496;

constexpr std::uint64_t kHeaderBits = 21;        // SECDED and tail included
constexpr std::uint64_t kReedSolomonBits = 330;  // of data to a block, which gets
constexpr std::uint64_t kReedSolomonParity = 48;

std::uint64_t bit_chips(int kbps) {
  switch (kbps) {
    case 110:
      return 4096;
    case 850:
      return 512;
    default:
      return 64;
  }
}

}  // namespace

std::uint64_t symbol_ticks(const Phy& phy) {
  return kTicksPerChip * (phy.prf_mhz == 16 ? kSymbolChips16 : kSymbolChips64);
}

std::uint64_t preamble_ticks(const Phy& phy) {
  return static_cast<std::uint64_t>(phy.preamble_symbols) * symbol_ticks(phy);
}

std::uint64_t sfd_ticks(const Phy& phy) { return (phy.kbps == 110 ? 64 : 8) * symbol_ticks(phy); }

// At 6.8 Mb/s the header still goes at 850 kb/s.
std::uint64_t header_ticks(const Phy& phy) {
  return kTicksPerChip * kHeaderBits * bit_chips(phy.kbps == 110 ? 110 : 850);
}

std::uint64_t data_ticks(const Phy& phy, std::size_t bytes) {
  const std::uint64_t bits = 8 * bytes;
  const std::uint64_t blocks = (bits + kReedSolomonBits - 1) / kReedSolomonBits;
  return kTicksPerChip * (bits + blocks * kReedSolomonParity) * bit_chips(phy.kbps);
}

}  // namespace air
