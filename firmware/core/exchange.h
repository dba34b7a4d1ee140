// Which stamps make a range: a node's frames and those of each other member, whoever they were meant for.
//
// For each other X: the last frame of X that came in before our own latest one (first), our own (second), and
// the first one of X after it that tells when our own came in (third). That is double-sided two-way ranging
// once for every frame we send, in any order of turns.
#pragma once

#include "frame.h"
#include "twr.h"

struct exchange_heard {
  bool known;
  uint8_t sequence;
  uint64_t sent;      // ticks of the other's clock
  uint64_t received;  // ticks of ours
  int16_t rx_power_cdbm;
};

struct exchange_peer {
  struct exchange_heard latest;
  bool since_ours;              // `latest` came in after our own latest frame, and is told in our next
  uint8_t ours_since;           // how many of our own frames were sent after it
  struct exchange_heard first;  // the last that came in before our own latest frame
};

struct exchange {
  uint8_t sequence;  // of our own latest frame
  uint64_t sent;     // and when it was sent
  struct exchange_peer peer[FRAME_MEMBERS];
};

// All that was heard is forgotten: numbers in the roster mean others now, or our clock began anew, or we were
// silent for more than 10 s. Stamps wrap after 17 s, and older ones would look fresh again.
void exchange_reset(struct exchange* exchange);

// Our own frame `sequence` has been sent.
void exchange_sent(struct exchange* exchange, uint8_t sequence, uint64_t sent);

// The stamps to tell in our next frame: of all that came in since our own latest one.
void exchange_tell(const struct exchange* exchange, struct frame* frame);

// A word of number `peer` came in; `us` is our own number. True where it completes a range: its three frames'
// stamps, and the mean power at which the first and third came in.
bool exchange_received(struct exchange* exchange, unsigned us, unsigned peer, const struct frame* word,
                       uint64_t received, int16_t rx_power_cdbm, struct twr_stamps* stamps,
                       int16_t* power_cdbm);
