// The radio's time: 40 bits of 1 / (128 x 499.2 MHz) = 15.65 ps, which wrap every 17.207 s.
#pragma once

#include <stdint.h>

#define TICKS_MASK ((UINT64_C(1) << 40) - 1)
#define TICKS_PER_MS UINT64_C(63897600)

static inline uint64_t ticks_of_us(uint64_t us) { return us * 638976 / 10; }

// Of less than a wrap.
static inline uint64_t ticks_to_ns(uint64_t ticks) { return ticks * 10000 / 638976; }

static inline uint64_t ticks_after(uint64_t ticks, uint64_t duration) {
  return (ticks + duration) & TICKS_MASK;
}

// From one moment to a later one less than a wrap away.
static inline uint64_t ticks_between(uint64_t earlier, uint64_t later) {
  return (later - earlier) & TICKS_MASK;
}

// From one moment to another less than half a wrap before or after it.
static inline int64_t ticks_until(uint64_t from, uint64_t to) {
  const int64_t ahead = (int64_t)ticks_between(from, to);
  return ahead > (int64_t)(TICKS_MASK >> 1) ? ahead - (int64_t)TICKS_MASK - 1 : ahead;
}

// Of two moments of the board's clock.
static inline uint64_t earlier_of(uint64_t a, uint64_t b) { return a < b ? a : b; }
static inline uint64_t later_of(uint64_t a, uint64_t b) { return a > b ? a : b; }
