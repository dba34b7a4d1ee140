// Any bytes as a datagram: as they are, with a tag that fits, and with a begin that fits too, so that what
// lies behind these is reached. What is read must be written as the same bytes.
#include <stdlib.h>
#include <string.h>

#include "blake2s.h"
#include "wire.h"

static const uint8_t key[WIRE_KEY_SIZE] = {1, 2, 3, 4, 5, 6, 7, 8};

static const uint8_t magic_and_version[] = {'S', 'Y', 'N', 'C', WIRE_VERSION};

static void check_same(const uint8_t* read, size_t read_size, const uint8_t* written, size_t written_size) {
  if (read_size != written_size || memcmp(read, written, read_size) != 0) abort();
}

static void read_both(const uint8_t* bytes, size_t size) {
  uint8_t again[WIRE_MAX_SIZE] = {0};
  struct wire_ranges ranges;
  struct wire_order order;
  if (wire_read_ranges(bytes, size, key, &ranges))
    check_same(bytes, size, again, wire_write_ranges(&ranges, key, again));
  if (wire_read_order(bytes, size, key, &order))
    check_same(bytes, size, again, wire_write_order(&order, key, again));
}

// With a tag that fits; in memory of its very size, so that a byte read beyond it is noticed.
static void read_sealed(const uint8_t* said, size_t size) {
  uint8_t* const sealed = malloc(size + WIRE_TAG_SIZE);
  if (sealed == NULL) return;
  if (size > 0) memcpy(sealed, said, size);
  blake2s(sealed + size, WIRE_TAG_SIZE, key, sizeof key, said, size);
  read_both(sealed, size + WIRE_TAG_SIZE);
  free(sealed);
}

// Makes magic, version, kind, count and size agree, so that every input reaches the values behind them. The
// new size.
static size_t begin_well(uint8_t* said, size_t size) {
  const size_t order_size = WIRE_ORDER_SIZE - WIRE_TAG_SIZE;
  if (size < order_size) return size;
  const bool ranges = size >= WIRE_HEADER_SIZE + WIRE_RANGE_SIZE;
  const size_t count = ranges ? (size - WIRE_HEADER_SIZE) / WIRE_RANGE_SIZE : 0;
  memcpy(said, magic_and_version, sizeof magic_and_version);
  said[5] = ranges ? WIRE_RANGES : WIRE_ORDER;
  said[6] = (uint8_t)count;
  return ranges ? WIRE_HEADER_SIZE + count * WIRE_RANGE_SIZE : order_size;
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  read_both(data, size);
  read_sealed(data, size);
  uint8_t said[2 * WIRE_MAX_SIZE];
  if (size == 0 || size > sizeof said) return 0;
  memcpy(said, data, size);
  read_sealed(said, begin_well(said, size));
  return 0;
}
