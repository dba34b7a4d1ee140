// Ranges on their way to the network: gathered into datagrams, kept while there is no room, dropped once too
// old.
#pragma once

#include "hal.h"
#include "wire.h"

#define OUTBOX_ROOM 128         // ranges
#define OUTBOX_GATHER_US 20000  // how long the first waits for others
#define OUTBOX_GREET_US 1000000
#define OUTBOX_TOO_OLD_US 500000

// `range.offset_us` is left to the outbox.
struct outbox_range {
  uint64_t at_us;  // of the board's clock, for its age
  uint32_t epoch;
  uint64_t time_ns;  // of the network's clock
  struct wire_range range;
};

struct outbox {
  uint32_t session;
  uint16_t reporter;
  uint64_t sequence;  // of the next datagram
  uint64_t sent_us;   // when the latest left, board clock
  uint32_t dropped;
  unsigned first, count;  // a ring
  struct outbox_range ring[OUTBOX_ROOM];
};

// `restarts` counts the starts of this module: it makes sequences rise over them.
void outbox_start(struct outbox* outbox, uint32_t session, uint16_t reporter, uint32_t restarts);

// When full the oldest is dropped, and counted.
void outbox_put(struct outbox* outbox, const struct outbox_range* range);

// Sends what is due at `now_us`, everything if `all`: a datagram holds ranges of one epoch, and is due when
// it can hold no more or its first has waited long enough. What the network has no room for stays. Returns
// when to be called again (board clock); UINT64_MAX: nothing waits.
uint64_t outbox_send(struct outbox* outbox, const struct hal* hal, const uint8_t key[WIRE_KEY_SIZE],
                     uint64_t now_us, bool all);

// A datagram without ranges, if none has left for a second: who tells nothing is there all the same. What it
// says of the network's clock is one moment of it.
void outbox_greet(struct outbox* outbox, const struct hal* hal, const uint8_t key[WIRE_KEY_SIZE],
                  uint64_t now_us, uint32_t epoch, uint64_t time_ns);
