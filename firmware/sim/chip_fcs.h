// The frame check sequence of IEEE 802.15.4: CRC-16 of x^16 + x^12 + x^5 + 1, least significant bit first,
// begun at 0.
#pragma once

#include <cstddef>
#include <cstdint>

namespace air {

inline std::uint16_t fcs(const std::uint8_t* bytes, std::size_t size) {
  std::uint32_t crc = 0;
  for (std::size_t i = 0; i < size; ++i) {
    crc ^= bytes[i];
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1U) != 0 ? (crc >> 1U) ^ 0x8408U : crc >> 1U;
  }
  return static_cast<std::uint16_t>(crc);
}

}  // namespace air
