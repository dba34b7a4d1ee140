#include <string.h>

#include "blake2s.h"
#include "bytes.h"
#include "check.h"
#include "wire_text.h"

static const struct {
  const char* what;
  const char* hex;
  const char* read;
} vectors[] = {
#include "vectors/wire_vectors.txt"
};
#define VECTORS (sizeof vectors / sizeof vectors[0])

static const struct {
  const char* room;
  uint32_t session;
  uint16_t address;
  const char* own;
} reporter_keys[] = {
#include "vectors/reporter_keys.txt"
};

static uint8_t key[WIRE_KEY_SIZE];
static char text[WIRE_TEXT_SIZE];

static void check_text(const char* expected, const char* what) {
  if (strcmp(text, expected) == 0) return;
  ++check_failures;
  printf("%s: is read as %s, not %s\n", what, text, expected);
}

static struct wire_ranges some_ranges(uint8_t count) {
  struct wire_ranges ranges = {
      .session = 5, .reporter = 7, .sequence = 11, .epoch = 13, .time_ns = 17, .count = count};
  for (unsigned i = 0; i < count; ++i)
    ranges.range[i] = (struct wire_range){.peer = (uint16_t)(100 + i),
                                          .distance_mm = (int32_t)i - 3,
                                          .sigma_mm = WIRE_UNKNOWN_SIGMA,
                                          .rx_power_cdbm = WIRE_UNKNOWN_POWER,
                                          .fp_power_cdbm = WIRE_UNKNOWN_POWER,
                                          .clock_ppb = WIRE_UNKNOWN_CLOCK};
  return ranges;
}

static void stored_datagrams_are_read_as_they_were_meant(void) {
  for (size_t i = 0; i < VECTORS; ++i) {
    uint8_t bytes[WIRE_MAX_SIZE + 64];
    wire_text(bytes, wire_text_bytes(vectors[i].hex, bytes, sizeof bytes), key, text);
    check_text(vectors[i].read, vectors[i].what);
  }
}

static void what_is_read_is_written_as_the_same_bytes(void) {
  unsigned written = 0;
  for (size_t i = 0; i < VECTORS; ++i) {
    uint8_t bytes[WIRE_MAX_SIZE + 64], again[WIRE_MAX_SIZE];
    const size_t size = wire_text_bytes(vectors[i].hex, bytes, sizeof bytes);
    struct wire_ranges ranges;
    struct wire_order order;
    size_t again_size;
    if (wire_read_ranges(bytes, size, key, &ranges))
      again_size = wire_write_ranges(&ranges, key, again);
    else if (wire_read_order(bytes, size, key, &order))
      again_size = wire_write_order(&order, key, again);
    else
      continue;
    CHECK_EQUAL(again_size, size);
    CHECK_EQUAL(memcmp(again, bytes, size), 0);
    ++written;
  }
  CHECK_EQUAL(written, 10);
}

static void every_bit_is_under_the_tag(void) {
  const struct wire_ranges ranges = some_ranges(2);
  const struct wire_order order = {.session = 5, .module = 7, .sequence = 11, .sleep_s = 3600};
  uint8_t bytes[WIRE_MAX_SIZE];
  struct wire_ranges ranges_read;
  struct wire_order order_read;
  size_t size = wire_write_ranges(&ranges, key, bytes);
  CHECK(wire_read_ranges(bytes, size, key, &ranges_read));
  for (size_t bit = 0; bit < 8 * size; ++bit) {
    bytes[bit / 8] ^= (uint8_t)(1U << bit % 8);
    CHECK(!wire_read_ranges(bytes, size, key, &ranges_read));
    bytes[bit / 8] ^= (uint8_t)(1U << bit % 8);
  }
  size = wire_write_order(&order, key, bytes);
  CHECK(wire_read_order(bytes, size, key, &order_read));
  for (size_t bit = 0; bit < 8 * size; ++bit) {
    bytes[bit / 8] ^= (uint8_t)(1U << bit % 8);
    CHECK(!wire_read_order(bytes, size, key, &order_read));
    bytes[bit / 8] ^= (uint8_t)(1U << bit % 8);
  }
}

// A module is given its key and cannot derive it; that PROTOCOL.md's recipe is the one is seen all the same.
static void a_reporter_s_key_is_what_the_recipe_makes(void) {
  for (size_t i = 0; i < sizeof reporter_keys / sizeof reporter_keys[0]; ++i) {
    uint8_t room[WIRE_KEY_SIZE], own[WIRE_KEY_SIZE], made[WIRE_KEY_SIZE];
    CHECK_EQUAL(wire_text_bytes(reporter_keys[i].room, room, sizeof room), WIRE_KEY_SIZE);
    CHECK_EQUAL(wire_text_bytes(reporter_keys[i].own, own, sizeof own), WIRE_KEY_SIZE);
    uint8_t said[27] = "synchronizar reporter";
    bytes_put(said + 21, reporter_keys[i].session, 4);
    bytes_put(said + 25, reporter_keys[i].address, 2);
    blake2s(made, sizeof made, room, sizeof room, said, sizeof said);
    CHECK_EQUAL(memcmp(made, own, sizeof own), 0);
  }
}

static void every_bit_of_the_key_counts(void) {
  const struct wire_ranges ranges = some_ranges(1);
  uint8_t bytes[WIRE_MAX_SIZE];
  struct wire_ranges read;
  const size_t size = wire_write_ranges(&ranges, key, bytes);
  for (unsigned bit = 0; bit < 8 * WIRE_KEY_SIZE; ++bit) {
    uint8_t other[WIRE_KEY_SIZE];
    memcpy(other, key, sizeof other);
    other[bit / 8] ^= (uint8_t)(1U << bit % 8);
    CHECK(!wire_read_ranges(bytes, size, other, &read));
  }
}

static void no_length_but_the_right_one_is_read(void) {
  const struct wire_ranges ranges = some_ranges(WIRE_MAX_RANGES);
  uint8_t bytes[WIRE_MAX_SIZE];
  struct wire_ranges read;
  struct wire_order order;
  CHECK_EQUAL(wire_write_ranges(&ranges, key, bytes), 824);
  for (size_t size = 0; size < WIRE_MAX_SIZE; ++size) {
    CHECK(!wire_read_ranges(bytes, size, key, &read));
    CHECK(!wire_read_order(bytes, size, key, &order));
  }
  CHECK(wire_read_ranges(bytes, WIRE_MAX_SIZE, key, &read));
}

static void what_no_reader_takes_is_not_written(void) {
  uint8_t bytes[WIRE_MAX_SIZE];
  struct wire_ranges ranges = some_ranges(2);
  CHECK(wire_write_ranges(&ranges, key, bytes) > 0);
#define NOT_WRITTEN_WITH(change)                            \
  do {                                                      \
    ranges = some_ranges(2);                                \
    change;                                                 \
    CHECK_EQUAL(wire_write_ranges(&ranges, key, bytes), 0); \
  } while (0)
  NOT_WRITTEN_WITH(ranges.count = WIRE_MAX_RANGES + 1);
  NOT_WRITTEN_WITH(ranges.reporter = WIRE_LAST_ADDRESS + 1);
  NOT_WRITTEN_WITH(ranges.time_ns = WIRE_MAX_TIME_NS + 1);
  NOT_WRITTEN_WITH(ranges.range[1].peer = ranges.reporter);
  NOT_WRITTEN_WITH(ranges.range[1].peer = WIRE_LAST_ADDRESS + 1);
  NOT_WRITTEN_WITH(ranges.range[1].source = WIRE_SIMULATED + 1);
  NOT_WRITTEN_WITH(ranges.range[1].status = WIRE_FAILED + 1);
  NOT_WRITTEN_WITH(ranges.range[1].distance_mm = WIRE_MAX_DISTANCE_MM + 1);
  NOT_WRITTEN_WITH(ranges.range[1].distance_mm = INT32_MIN);
  NOT_WRITTEN_WITH(ranges.range[1].sigma_mm = 0);
  NOT_WRITTEN_WITH(ranges.range[1].sight = 2);
  NOT_WRITTEN_WITH(ranges.range[1].offset_us = -WIRE_MAX_OFFSET_US - 1);
#undef NOT_WRITTEN_WITH
  const struct wire_order order = {.module = WIRE_LAST_ADDRESS + 1};
  CHECK_EQUAL(wire_write_order(&order, key, bytes), 0);
}

static void a_sequence_is_taken_once(void) {
  struct wire_window window = {0};
  CHECK(wire_window_take(&window, 100));
  CHECK(!wire_window_take(&window, 100));
  CHECK(wire_window_take(&window, 102));
  CHECK(wire_window_take(&window, 101));
  CHECK(!wire_window_take(&window, 101));
  CHECK(!wire_window_take(&window, 100));
}

static void the_window_reaches_63_behind_the_newest(void) {
  struct wire_window window = {0};
  CHECK(wire_window_take(&window, 1000));
  CHECK(!wire_window_take(&window, 1000 - 64));
  CHECK(wire_window_take(&window, 1000 - 63));
  CHECK(!wire_window_take(&window, 1000 - 63));
  CHECK(wire_window_take(&window, 1063));  // 1000 is 63 behind now
  CHECK(!wire_window_take(&window, 1000));
  CHECK(wire_window_take(&window, 1001));
  CHECK(wire_window_take(&window, 1064 + 63));  // and 1063 is 64 behind
  CHECK(!wire_window_take(&window, 1063));
  CHECK(wire_window_take(&window, 1064));
}

static void sequences_go_from_zero_to_the_last(void) {
  struct wire_window window = {0};
  CHECK(wire_window_take(&window, 0));
  CHECK(!wire_window_take(&window, 0));
  CHECK(wire_window_take(&window, UINT64_MAX));
  CHECK(!wire_window_take(&window, UINT64_MAX));
  CHECK(!wire_window_take(&window, 0));
}

// A xorshift and a table of all that was ever taken, against the window.
static void the_window_agrees_with_a_list_of_all(void) {
  enum { ALL = 4000 };
  static uint8_t taken[ALL];
  struct wire_window window = {0};
  uint64_t newest = 0;
  uint32_t random = 2463534242;
  for (unsigned i = 0; i < 20000; ++i) {
    random ^= random << 13, random ^= random >> 17, random ^= random << 5;
    uint64_t sequence = newest + random % 90;
    sequence = sequence < 80 ? 0 : sequence - 80;
    if (sequence >= ALL) break;
    const int fresh = taken[sequence] == 0 && sequence + 64 > newest;
    CHECK_EQUAL(wire_window_take(&window, sequence), fresh);
    if (fresh) taken[sequence] = 1;
    if (sequence > newest) newest = sequence;
  }
  CHECK_WITHIN(newest, 3000, ALL);
}

int main(void) {
  wire_text_key(key);
  stored_datagrams_are_read_as_they_were_meant();
  what_is_read_is_written_as_the_same_bytes();
  every_bit_is_under_the_tag();
  every_bit_of_the_key_counts();
  a_reporter_s_key_is_what_the_recipe_makes();
  no_length_but_the_right_one_is_read();
  what_no_reader_takes_is_not_written();
  a_sequence_is_taken_once();
  the_window_reaches_63_behind_the_newest();
  sequences_go_from_zero_to_the_last();
  the_window_agrees_with_a_list_of_all();
  return check_verdict();
}
