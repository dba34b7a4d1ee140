// Finds others, keeps a network with them and ranges by its timetable. Driven by events; every call returns
// the next deadline.
//
// Who hears nobody begins a network and coordinates it: it says the plan at the begin of each round, and
// everybody else sends in the slots that the timetable gives its number in the roster, counted from that
// frame. Who misses it is silent for a round. When the coordinator falls silent the first member goes on in
// its place, by the same network clock.
#pragma once

#include "dw1000.h"
#include "exchange.h"
#include "frame.h"
#include "roster.h"
#include "timetable.h"

enum ranging_state {
  RANGING_DISCOVERING,  // listens whether there is a network
  RANGING_JOINING,      // there is one; asks to be taken up
  RANGING_MEMBER,
  RANGING_COORDINATING,
  RANGING_LEFT,
};

struct ranging_settings {
  uint16_t pan;
  uint16_t address;
  uint8_t scheme;     // where this node coordinates
  uint32_t restarts;  // of this node, and
  uint32_t epochs;    // epochs that it has begun since the latest: no epoch is named twice
};

enum ranging_event_kind { RANGING_DEADLINE, RANGING_SENT, RANGING_RECEIVED, RANGING_LOST };

struct ranging_event {
  enum ranging_event_kind kind;
  uint64_t stamp;        // SENT, RECEIVED: ticks
  const uint8_t* bytes;  // RECEIVED, without the FCS, and
  size_t size;
  int16_t rx_power_cdbm, fp_power_cdbm;
  int32_t clock_ppb;
};

// One distance, as the stamps have it: its bias by power is still in it.
struct ranging_result {
  uint16_t peer;
  bool overheard;  // neither of the two was the other's addressee
  int32_t distance_um;
  int16_t rx_power_cdbm, fp_power_cdbm;
  int32_t clock_ppb;
  uint32_t epoch;    // of the network's clock
  uint64_t time_ns;  // when our own frame of the exchange was sent
};

// Longer than a network that works is ever silent, and than looking for one takes; far below half a wrap of
// the stamps.
#define RANGING_NEVER_SILENT_US 5000000

#define RANGING_JOIN_SLOTS 2  // at the end of a round that has them

enum ranging_waiting { WAITING_NOTHING, WAITING_WORD, WAITING_POLL, WAITING_JOIN };

struct ranging {
  struct dw1000* radio;
  struct ranging_settings settings;
  enum ranging_state state;
  uint32_t random;
  uint64_t now_us;       // board clock at the event that is being worked on
  uint64_t deadline_us;  // of DISCOVERING, and of a frame that waits

  // The network.
  uint8_t scheme;
  struct roster roster;
  uint8_t us;  // our own number
  uint32_t epoch;
  uint64_t epoch_ticks, epoch_ns;  // one moment by the radio's and by the network's clock
  uint64_t heard_us;               // when anything of this network was last heard

  // The round.
  uint16_t round;
  uint64_t round_ticks;  // when slot 0 was sent or came in
  uint64_t round_us;     // the same by the board's clock
  uint32_t rest_us;      // by how much the round is longer than its timetable
  bool joining;          // slots to join in follow it
  unsigned slot;         // the next one that we send in; past the last: none

  // The frame that waits in the radio for its moment.
  enum ranging_waiting waiting;
  bool last_word;  // that says that we leave
  uint8_t sequence;
  uint64_t sent;  // the stamp it will have

  // Joining and leaving.
  uint8_t roster_found;                 // its version when we found the network
  uint64_t joining_us;                  // when slots to join in shall follow a round again
  uint16_t joined[RANGING_JOIN_SLOTS];  // who asked for it in this round
  uint8_t joined_count;
  uint8_t tries;    // to join
  uint8_t backoff;  // chances to join to let go by
  bool leaving;

  struct exchange exchange;
};

// `random` is anything that differs between nodes. The radio has been started. Returns the first deadline,
// board clock.
uint64_t ranging_start(struct ranging* ranging, struct dw1000* radio, const struct ranging_settings* settings,
                       uint32_t random);

// Returns the next deadline; *found tells whether *result is a new distance.
uint64_t ranging_on_event(struct ranging* ranging, const struct ranging_event* event,
                          struct ranging_result* result, bool* found);

// From now on it says in its next frame that it leaves; the state is LEFT once that has been sent.
void ranging_leave(struct ranging* ranging);
