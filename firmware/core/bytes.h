// Little-endian numbers of up to eight bytes, as the radio, the frames and the datagrams have them.
#pragma once

#include <stddef.h>
#include <stdint.h>

static inline void bytes_put(uint8_t* to, uint64_t number, size_t size) {
  for (size_t i = 0; i < size; ++i) to[i] = (uint8_t)(number >> 8 * i);
}

static inline uint64_t bytes_get(const uint8_t* from, size_t size) {
  uint64_t number = 0;
  for (size_t i = 0; i < size; ++i) number |= (uint64_t)from[i] << 8 * i;
  return number;
}
