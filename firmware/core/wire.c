#include "wire.h"

#include "blake2s.h"
#include "bytes.h"
#include "calibration.h"

// Offsets as in PROTOCOL.md, "On the network". What both kinds begin with:
enum {
  AT_MAGIC = 0,
  AT_VERSION = 4,
  AT_KIND = 5,
  AT_COUNT = 6,  // of ranges
  AT_RESERVED_7 = 7,
  AT_SESSION = 8,
  AT_ADDRESS = 12,  // of the reporter, or of the module that is ordered
  AT_RESERVED_14 = 14,
  AT_SEQUENCE = 16,
};
// Then ranges have
enum { AT_TIME = 24, AT_EPOCH = 32, AT_DROPPED = 36 };
// and an order has
enum { AT_SLEEP = 24 };
// Each range:
enum {
  RANGE_PEER = 0,
  RANGE_SOURCE = 2,
  RANGE_STATUS = 3,
  RANGE_DISTANCE = 4,
  RANGE_OFFSET = 8,
  RANGE_CLOCK = 12,
  RANGE_SIGMA = 16,
  RANGE_RX_POWER = 18,
  RANGE_FP_POWER = 20,
  RANGE_SIGHT = 22,
  RANGE_RESERVED_23 = 23,
};

static const uint8_t magic[4] = {'S', 'Y', 'N', 'C'};

static void tag_of(const uint8_t* bytes, size_t size, const uint8_t key[WIRE_KEY_SIZE],
                   uint8_t tag[WIRE_TAG_SIZE]) {
  blake2s(tag, WIRE_TAG_SIZE, key, WIRE_KEY_SIZE, bytes, size);
}

// In a time that does not tell how much of the tag is right.
static bool has_tag(const uint8_t* bytes, size_t size, const uint8_t key[WIRE_KEY_SIZE]) {
  uint8_t tag[WIRE_TAG_SIZE];
  tag_of(bytes, size - WIRE_TAG_SIZE, key, tag);
  unsigned different = 0;
  for (size_t i = 0; i < WIRE_TAG_SIZE; ++i)
    different |= (unsigned)(tag[i] ^ bytes[size - WIRE_TAG_SIZE + i]);
  return different == 0;
}

static void put_begin(uint8_t* bytes, enum wire_kind kind, uint8_t count, uint32_t session, uint16_t address,
                      uint64_t sequence) {
  for (size_t i = 0; i < sizeof magic; ++i) bytes[AT_MAGIC + i] = magic[i];
  bytes[AT_VERSION] = WIRE_VERSION;
  bytes[AT_KIND] = (uint8_t)kind;
  bytes[AT_COUNT] = count;
  bytes[AT_RESERVED_7] = 0;
  bytes_put(bytes + AT_SESSION, session, 4);
  bytes_put(bytes + AT_ADDRESS, address, 2);
  bytes_put(bytes + AT_RESERVED_14, 0, 2);
  bytes_put(bytes + AT_SEQUENCE, sequence, 8);
}

static bool begins_as(const uint8_t* bytes, enum wire_kind kind) {
  for (size_t i = 0; i < sizeof magic; ++i)
    if (bytes[AT_MAGIC + i] != magic[i]) return false;
  return bytes[AT_VERSION] == WIRE_VERSION && bytes[AT_KIND] == kind && bytes[AT_RESERVED_7] == 0 &&
         bytes_get(bytes + AT_RESERVED_14, 2) == 0;
}

static bool is_range(const struct wire_range* range, uint16_t reporter) {
  return range->peer <= WIRE_LAST_ADDRESS && range->peer != reporter && range->source <= WIRE_SIMULATED &&
         range->status <= WIRE_FAILED && range->distance_mm >= -WIRE_MAX_DISTANCE_MM &&
         range->distance_mm <= WIRE_MAX_DISTANCE_MM && range->sigma_mm > 0 &&
         (range->sight == SIGHT_CLEAR || range->sight == SIGHT_BLOCKED || range->sight == SIGHT_UNKNOWN) &&
         range->offset_us >= -WIRE_MAX_OFFSET_US && range->offset_us <= WIRE_MAX_OFFSET_US;
}

static bool are_ranges(const struct wire_ranges* ranges) {
  if (ranges->count > WIRE_MAX_RANGES || ranges->reporter > WIRE_LAST_ADDRESS ||
      ranges->time_ns > WIRE_MAX_TIME_NS)
    return false;
  for (unsigned i = 0; i < ranges->count; ++i)
    if (!is_range(&ranges->range[i], ranges->reporter)) return false;
  return true;
}

static void put_range(uint8_t* at, const struct wire_range* range) {
  bytes_put(at + RANGE_PEER, range->peer, 2);
  at[RANGE_SOURCE] = range->source;
  at[RANGE_STATUS] = range->status;
  bytes_put(at + RANGE_DISTANCE, (uint32_t)range->distance_mm, 4);
  bytes_put(at + RANGE_OFFSET, (uint32_t)range->offset_us, 4);
  bytes_put(at + RANGE_CLOCK, (uint32_t)range->clock_ppb, 4);
  bytes_put(at + RANGE_SIGMA, range->sigma_mm, 2);
  bytes_put(at + RANGE_RX_POWER, (uint16_t)range->rx_power_cdbm, 2);
  bytes_put(at + RANGE_FP_POWER, (uint16_t)range->fp_power_cdbm, 2);
  at[RANGE_SIGHT] = range->sight;
  at[RANGE_RESERVED_23] = 0;
}

static struct wire_range get_range(const uint8_t* at) {
  return (struct wire_range){
      .peer = (uint16_t)bytes_get(at + RANGE_PEER, 2),
      .source = at[RANGE_SOURCE],
      .status = at[RANGE_STATUS],
      .distance_mm = (int32_t)bytes_get(at + RANGE_DISTANCE, 4),
      .sigma_mm = (uint16_t)bytes_get(at + RANGE_SIGMA, 2),
      .sight = at[RANGE_SIGHT],
      .offset_us = (int32_t)bytes_get(at + RANGE_OFFSET, 4),
      .rx_power_cdbm = (int16_t)bytes_get(at + RANGE_RX_POWER, 2),
      .fp_power_cdbm = (int16_t)bytes_get(at + RANGE_FP_POWER, 2),
      .clock_ppb = (int32_t)bytes_get(at + RANGE_CLOCK, 4),
  };
}

size_t wire_write_ranges(const struct wire_ranges* ranges, const uint8_t key[WIRE_KEY_SIZE],
                         uint8_t bytes[WIRE_MAX_SIZE]) {
  if (!are_ranges(ranges)) return 0;
  put_begin(bytes, WIRE_RANGES, ranges->count, ranges->session, ranges->reporter, ranges->sequence);
  bytes_put(bytes + AT_TIME, ranges->time_ns, 8);
  bytes_put(bytes + AT_EPOCH, ranges->epoch, 4);
  bytes_put(bytes + AT_DROPPED, ranges->dropped, 4);
  size_t size = WIRE_HEADER_SIZE;
  for (unsigned i = 0; i < ranges->count; ++i, size += WIRE_RANGE_SIZE)
    put_range(bytes + size, &ranges->range[i]);
  tag_of(bytes, size, key, bytes + size);
  return size + WIRE_TAG_SIZE;
}

size_t wire_write_order(const struct wire_order* order, const uint8_t key[WIRE_KEY_SIZE],
                        uint8_t bytes[WIRE_MAX_SIZE]) {
  if (order->module > WIRE_LAST_ADDRESS) return 0;
  put_begin(bytes, WIRE_ORDER, 0, order->session, order->module, order->sequence);
  bytes_put(bytes + AT_SLEEP, order->sleep_s, 4);
  tag_of(bytes, WIRE_ORDER_SIZE - WIRE_TAG_SIZE, key, bytes + WIRE_ORDER_SIZE - WIRE_TAG_SIZE);
  return WIRE_ORDER_SIZE;
}

bool wire_read_ranges(const uint8_t* bytes, size_t size, const uint8_t key[WIRE_KEY_SIZE],
                      struct wire_ranges* ranges) {
  if (size < WIRE_HEADER_SIZE + WIRE_TAG_SIZE || size > WIRE_MAX_SIZE) return false;
  if (!has_tag(bytes, size, key) || !begins_as(bytes, WIRE_RANGES)) return false;
  const uint8_t count = bytes[AT_COUNT];
  if (size != (size_t)WIRE_HEADER_SIZE + count * (size_t)WIRE_RANGE_SIZE + WIRE_TAG_SIZE) return false;
  ranges->session = (uint32_t)bytes_get(bytes + AT_SESSION, 4);
  ranges->reporter = (uint16_t)bytes_get(bytes + AT_ADDRESS, 2);
  ranges->sequence = bytes_get(bytes + AT_SEQUENCE, 8);
  ranges->epoch = (uint32_t)bytes_get(bytes + AT_EPOCH, 4);
  ranges->time_ns = bytes_get(bytes + AT_TIME, 8);
  ranges->dropped = (uint32_t)bytes_get(bytes + AT_DROPPED, 4);
  ranges->count = count;
  for (unsigned i = 0; i < count; ++i) {
    const uint8_t* const at = bytes + WIRE_HEADER_SIZE + i * (size_t)WIRE_RANGE_SIZE;
    if (at[RANGE_RESERVED_23] != 0) return false;
    ranges->range[i] = get_range(at);
  }
  return are_ranges(ranges);
}

bool wire_read_order(const uint8_t* bytes, size_t size, const uint8_t key[WIRE_KEY_SIZE],
                     struct wire_order* order) {
  if (size != WIRE_ORDER_SIZE || !has_tag(bytes, size, key)) return false;
  if (!begins_as(bytes, WIRE_ORDER) || bytes[AT_COUNT] != 0) return false;
  order->session = (uint32_t)bytes_get(bytes + AT_SESSION, 4);
  order->module = (uint16_t)bytes_get(bytes + AT_ADDRESS, 2);
  order->sequence = bytes_get(bytes + AT_SEQUENCE, 8);
  order->sleep_s = (uint32_t)bytes_get(bytes + AT_SLEEP, 4);
  return order->module <= WIRE_LAST_ADDRESS;
}

bool wire_window_take(struct wire_window* window, uint64_t sequence) {
  if (!window->any || sequence > window->newest) {
    const uint64_t ahead = sequence - window->newest;
    window->taken = window->any && ahead < 64 ? window->taken << ahead | 1 : 1;
    window->any = true;
    window->newest = sequence;
    return true;
  }
  const uint64_t behind = window->newest - sequence;
  if (behind >= 64 || (window->taken >> behind & 1) != 0) return false;
  window->taken |= UINT64_C(1) << behind;
  return true;
}
