#include "exchange.h"

#include "dw1000.h"

// A frame that came in before so many of ours is forgotten, lest its stamps look fresh again after a wrap.
// More than a polling coordinator sends in a round, and with the longest rounds, 290 ms, less than 10 s.
#define FORGOTTEN_AFTER 32

void exchange_reset(struct exchange* exchange) { *exchange = (struct exchange){0}; }

void exchange_sent(struct exchange* exchange, uint8_t sequence, uint64_t sent) {
  exchange->sequence = sequence;
  exchange->sent = sent;
  for (unsigned i = 0; i < FRAME_MEMBERS; ++i) {
    struct exchange_peer* peer = &exchange->peer[i];
    if (peer->latest.known && ++peer->ours_since > FORGOTTEN_AFTER) peer->latest.known = false;
    peer->first = peer->latest;
    peer->since_ours = false;
  }
}

void exchange_tell(const struct exchange* exchange, struct frame* frame) {
  frame->heard = 0;
  for (unsigned i = 0; i < FRAME_MEMBERS; ++i) {
    const struct exchange_peer* peer = &exchange->peer[i];
    if (!peer->since_ours) continue;
    frame->heard |= (uint16_t)(1U << i);
    frame->stamp[i].sequence = peer->latest.sequence;
    frame->stamp[i].received = peer->latest.received;
  }
}

static int16_t mean_power(int16_t one, int16_t other) {
  if (one == DW1000_UNKNOWN_POWER || other == DW1000_UNKNOWN_POWER) return DW1000_UNKNOWN_POWER;
  return (int16_t)((one + other) / 2);
}

bool exchange_received(struct exchange* exchange, unsigned us, unsigned peer, const struct frame* word,
                       uint64_t received, int16_t rx_power_cdbm, struct twr_stamps* stamps,
                       int16_t* power_cdbm) {
  if (us >= FRAME_MEMBERS || peer >= FRAME_MEMBERS || us == peer) return false;
  struct exchange_peer* with = &exchange->peer[peer];
  if (with->latest.known && word->sent == with->latest.sent) return false;  // the same frame again

  const bool tells = (word->heard >> us & 1) != 0 && word->stamp[us].sequence == exchange->sequence;
  const bool complete = tells && with->first.known;
  if (complete) {
    *stamps = (struct twr_stamps){
        .first_sent = with->first.sent,
        .first_received = with->first.received,
        .second_sent = exchange->sent,
        .second_received = word->stamp[us].received,
        .third_sent = word->sent,
        .third_received = received,
    };
    *power_cdbm = mean_power(with->first.rx_power_cdbm, rx_power_cdbm);
    with->first.known = false;  // each range is made once
  }

  with->latest = (struct exchange_heard){
      .known = true,
      .sequence = word->sequence,
      .sent = word->sent,
      .received = received,
      .rx_power_cdbm = rx_power_cdbm,
  };
  with->since_ours = true;
  with->ours_since = 0;
  return complete;
}
