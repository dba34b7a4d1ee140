// Datagrams as text, as in vectors/wire_vectors.txt.
#pragma once

#include <inttypes.h>
#include <stdio.h>

#include "wire.h"

#define WIRE_TEXT_SIZE 8192

// The key of all tests: the bytes 0 to 31.
static inline void wire_text_key(uint8_t key[WIRE_KEY_SIZE]) {
  for (unsigned i = 0; i < WIRE_KEY_SIZE; ++i) key[i] = (uint8_t)i;
}

static inline unsigned wire_text_digit(char digit) {
  return (unsigned)(digit <= '9' ? digit - '0' : digit - 'a' + 10);
}

// Bytes of a row of hexadecimal digits, as far as it goes and there is room.
static inline size_t wire_text_bytes(const char* hex, uint8_t* bytes, size_t room) {
  size_t size = 0;
  for (; size < room && hex[0] > ' ' && hex[1] > ' '; hex += 2, ++size)
    bytes[size] = (uint8_t)(wire_text_digit(hex[0]) << 4 | wire_text_digit(hex[1]));
  return size;
}

static inline void wire_text_ranges(const struct wire_ranges* ranges, char text[WIRE_TEXT_SIZE]) {
  size_t end = (size_t)snprintf(
      text, WIRE_TEXT_SIZE, "ranges %" PRIu32 " %u %" PRIu64 " %" PRIu64 " %" PRIu32 " %" PRIu32,
      ranges->session, ranges->reporter, ranges->sequence, ranges->time_ns, ranges->epoch, ranges->dropped);
  for (unsigned i = 0; i < ranges->count; ++i) {
    const struct wire_range* const range = &ranges->range[i];
    end += (size_t)snprintf(
        text + end, WIRE_TEXT_SIZE - end, " | %u %u %u %" PRId32 " %" PRId32 " %" PRId32 " %u %d %d %u",
        range->peer, range->source, range->status, range->distance_mm, range->offset_us, range->clock_ppb,
        range->sigma_mm, range->rx_power_cdbm, range->fp_power_cdbm, range->sight);
  }
}

// What a reader makes of a datagram.
static inline void wire_text(const uint8_t* bytes, size_t size, const uint8_t key[WIRE_KEY_SIZE],
                             char text[WIRE_TEXT_SIZE]) {
  struct wire_ranges ranges;
  struct wire_order order;
  if (wire_read_ranges(bytes, size, key, &ranges))
    wire_text_ranges(&ranges, text);
  else if (wire_read_order(bytes, size, key, &order))
    snprintf(text, WIRE_TEXT_SIZE, "order %" PRIu32 " %u %" PRIu64 " %" PRIu32, order.session, order.module,
             order.sequence, order.sleep_s);
  else
    snprintf(text, WIRE_TEXT_SIZE, "refused");
}
