#include "outbox.h"

#include <string.h>

static const struct outbox_range* waiting(const struct outbox* outbox, unsigned i) {
  return &outbox->ring[(outbox->first + i) % OUTBOX_ROOM];
}

static void remove_oldest(struct outbox* outbox, unsigned count) {
  outbox->first = (outbox->first + count) % OUTBOX_ROOM;
  outbox->count -= count;
}

static void drop_oldest(struct outbox* outbox, unsigned count) {
  remove_oldest(outbox, count);
  outbox->dropped += count;
}

// From one moment of the network's clock to another, to the nearest microsecond.
static int64_t us_between(uint64_t from_ns, uint64_t to_ns) {
  const uint64_t apart_ns = to_ns >= from_ns ? to_ns - from_ns : from_ns - to_ns;
  const int64_t apart_us = (int64_t)(apart_ns / 1000 + (apart_ns % 1000 >= 500 ? 1 : 0));
  return to_ns >= from_ns ? apart_us : -apart_us;
}

// How many of the oldest go into one datagram: those of the same clock, within what an offset can say.
static unsigned of_one_datagram(const struct outbox* outbox) {
  const struct outbox_range* const oldest = waiting(outbox, 0);
  unsigned count = 1;
  for (; count < outbox->count && count < WIRE_MAX_RANGES; ++count) {
    const struct outbox_range* const next = waiting(outbox, count);
    const int64_t offset_us = us_between(oldest->time_ns, next->time_ns);
    if (next->epoch != oldest->epoch || offset_us < -WIRE_MAX_OFFSET_US || offset_us > WIRE_MAX_OFFSET_US)
      break;
  }
  return count;
}

static size_t write_oldest(const struct outbox* outbox, unsigned count, const uint8_t key[WIRE_KEY_SIZE],
                           uint8_t bytes[WIRE_MAX_SIZE]) {
  const struct outbox_range* const oldest = waiting(outbox, 0);
  struct wire_ranges ranges = {
      .session = outbox->session,
      .reporter = outbox->reporter,
      .sequence = outbox->sequence,
      .epoch = oldest->epoch,
      .time_ns = oldest->time_ns,
      .dropped = outbox->dropped,
      .count = (uint8_t)count,
  };
  for (unsigned i = 0; i < count; ++i) {
    ranges.range[i] = waiting(outbox, i)->range;
    ranges.range[i].offset_us = (int32_t)us_between(oldest->time_ns, waiting(outbox, i)->time_ns);
  }
  return wire_write_ranges(&ranges, key, bytes);
}

void outbox_start(struct outbox* outbox, uint32_t session, uint16_t reporter, uint32_t restarts) {
  memset(outbox, 0, sizeof *outbox);
  outbox->session = session;
  outbox->reporter = reporter;
  outbox->sequence = (uint64_t)restarts << 32;
}

void outbox_put(struct outbox* outbox, const struct outbox_range* range) {
  if (outbox->count == OUTBOX_ROOM) drop_oldest(outbox, 1);
  outbox->ring[(outbox->first + outbox->count) % OUTBOX_ROOM] = *range;
  ++outbox->count;
}

uint64_t outbox_send(struct outbox* outbox, const struct hal* hal, const uint8_t key[WIRE_KEY_SIZE],
                     uint64_t now_us, bool all) {
  while (outbox->count > 0 && now_us > waiting(outbox, 0)->at_us + OUTBOX_TOO_OLD_US) drop_oldest(outbox, 1);
  while (outbox->count > 0) {
    const unsigned count = of_one_datagram(outbox);
    const bool complete = count == WIRE_MAX_RANGES || count < outbox->count;
    const uint64_t due_us = waiting(outbox, 0)->at_us + OUTBOX_GATHER_US;
    if (!all && !complete && now_us < due_us) return due_us;
    uint8_t bytes[WIRE_MAX_SIZE];
    const size_t size = write_oldest(outbox, count, key, bytes);
    if (size == 0) {
      drop_oldest(outbox, count);  // out of bounds: it would never be taken
      continue;
    }
    if (!hal->send(hal->board, bytes, size)) return now_us + OUTBOX_GATHER_US;
    ++outbox->sequence;
    outbox->sent_us = now_us;
    remove_oldest(outbox, count);
  }
  return UINT64_MAX;
}

void outbox_greet(struct outbox* outbox, const struct hal* hal, const uint8_t key[WIRE_KEY_SIZE],
                  uint64_t now_us, uint32_t epoch, uint64_t time_ns) {
  if (now_us - outbox->sent_us < OUTBOX_GREET_US) return;
  const struct wire_ranges greeting = {
      .session = outbox->session,
      .reporter = outbox->reporter,
      .sequence = outbox->sequence,
      .epoch = epoch,
      .time_ns = time_ns,
      .dropped = outbox->dropped,
  };
  uint8_t bytes[WIRE_MAX_SIZE];
  const size_t size = wire_write_ranges(&greeting, key, bytes);
  outbox->sent_us = now_us;  // without a network it is tried no more often
  if (size > 0 && hal->send(hal->board, bytes, size)) ++outbox->sequence;
}
