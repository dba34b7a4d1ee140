// Datagrams between modules and whoever collects ranges. The layout is the table "On the network" in
// PROTOCOL.md, the one truth.
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define WIRE_VERSION 2
#define WIRE_KEY_SIZE 32
#define WIRE_TAG_SIZE 16
#define WIRE_MAX_RANGES 32
#define WIRE_HEADER_SIZE 40
#define WIRE_RANGE_SIZE 24
#define WIRE_ORDER_SIZE (28 + WIRE_TAG_SIZE)
#define WIRE_MAX_SIZE (WIRE_HEADER_SIZE + WIRE_MAX_RANGES * WIRE_RANGE_SIZE + WIRE_TAG_SIZE)

enum wire_kind { WIRE_RANGES = 1, WIRE_ORDER = 2 };
enum wire_source { WIRE_MODULE = 0, WIRE_OVERHEARD, WIRE_ANDROID, WIRE_APPLE, WIRE_SIMULATED };
enum wire_status { WIRE_MEASURED = 0, WIRE_DOUBTFUL, WIRE_FAILED };

#define WIRE_LAST_ADDRESS 0xFFFD              // IEEE 802.15.4 keeps the two above for other things
#define WIRE_MAX_DISTANCE_MM 10000000         // 10 km, either sign
#define WIRE_MAX_OFFSET_US 10000000           // 10 s, either sign
#define WIRE_MAX_TIME_NS (UINT64_C(1) << 62)  // 146 years; with an offset still within int64_t

#define WIRE_UNKNOWN_SIGMA UINT16_MAX
#define WIRE_UNKNOWN_POWER INT16_MIN
#define WIRE_UNKNOWN_CLOCK INT32_MIN

struct wire_range {
  uint16_t peer;
  uint8_t source;       // wire_source
  uint8_t status;       // wire_status
  int32_t distance_mm;  // may be below 0
  uint16_t sigma_mm;    // at least 1
  uint8_t sight;        // calibration_sight
  int32_t offset_us;    // after the datagram's time
  int16_t rx_power_cdbm;
  int16_t fp_power_cdbm;
  int32_t clock_ppb;  // by how much the peer's clock is faster than the reporter's
};

struct wire_ranges {
  uint32_t session;
  uint16_t reporter;
  uint64_t sequence;  // ever rising, over restarts too: restarts in the upper 32 bits
  uint32_t epoch;     // of the clock that `time_ns` and all offsets are of
  uint64_t time_ns;
  uint32_t dropped;  // ranges since the start that were too old to be sent
  uint8_t count;     // 0: a greeting
  struct wire_range range[WIRE_MAX_RANGES];
};

// What a collector tells a module.
struct wire_order {
  uint32_t session;
  uint16_t module;
  uint64_t sequence;  // of the module's datagram that it answers: a later start takes no older order
  uint32_t sleep_s;   // registered: sleep so long; 0: range on
};

// Bytes written, the tag of `key`, the module's own, at the end; 0 where a value is out of its bounds, so
// that no reader would take them.
size_t wire_write_ranges(const struct wire_ranges* ranges, const uint8_t key[WIRE_KEY_SIZE],
                         uint8_t bytes[WIRE_MAX_SIZE]);
size_t wire_write_order(const struct wire_order* order, const uint8_t key[WIRE_KEY_SIZE],
                        uint8_t bytes[WIRE_MAX_SIZE]);

// False for whatever is not exactly such a datagram, or has another key's tag.
bool wire_read_ranges(const uint8_t* bytes, size_t size, const uint8_t key[WIRE_KEY_SIZE],
                      struct wire_ranges* ranges);
bool wire_read_order(const uint8_t* bytes, size_t size, const uint8_t key[WIRE_KEY_SIZE],
                     struct wire_order* order);

// Which sequences of one sender have been taken: of the newest and the 63 before it.
struct wire_window {
  bool any;
  uint64_t newest;
  uint64_t taken;  // bit i: newest - i
};

// True once for each sequence that is not too old; false for one that came before.
bool wire_window_take(struct wire_window* window, uint64_t sequence);
