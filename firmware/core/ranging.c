#include "ranging.h"

#include "ticks.h"

// From taking up a frame until its first stamped symbol: seven SPI transactions of some 25 us, the preamble's
// 138 us, and as much again as the board may be late.
#define LEAD_US 450
#define FIRST_ROUND_US 2000   // from deciding to coordinate until the first poll
#define JOIN_EVERY_US 100000  // on average
#define SILENT_ROUNDS 16      // at 30 % loss of every frame this happens once in 10^8 rounds
#define SILENT_AT_LEAST_US 50000
#define SILENT_AT_MOST_US 2000000
#define TAKE_OVER_STEP_US UINT64_C(20000)  // time for several polls of whoever is first
#define MEMBER_SILENT_US 500000            // or so many rounds, whichever is more; then it is dropped
#define SENT_WITHIN_US 5000                // after its moment; or the radio has forgotten it
#define MOST_BACKOFF 16

_Static_assert(SILENT_AT_MOST_US + FRAME_MEMBERS * TAKE_OVER_STEP_US < RANGING_NEVER_SILENT_US,
               "a network that works is never silent for so long");

static uint32_t draw(struct ranging* r, uint32_t below) {  // xorshift (Marsaglia 2003)
  r->random ^= r->random << 13;
  r->random ^= r->random >> 17;
  r->random ^= r->random << 5;
  return r->random % below;
}

// --- The round

static unsigned slots(const struct ranging* r) { return timetable_slots(r->scheme, r->roster.members); }

static uint32_t round_us(const struct ranging* r) {
  return timetable_round_us(r->scheme, r->roster.members) + r->rest_us;
}

static uint32_t in_round_us(const struct ranging* r, unsigned slot) {
  return slot * timetable_slot_us(r->scheme);
}

static unsigned own_slot(const struct ranging* r, unsigned from) {
  unsigned slot = from;
  while (slot < slots(r) && timetable_sender(r->scheme, r->roster.members, slot) != r->us) ++slot;
  return slot;
}

static uint64_t silence_us(const struct ranging* r) {
  const uint64_t rounds_us = (uint64_t)SILENT_ROUNDS * timetable_round_us(r->scheme, r->roster.members);
  return earlier_of(later_of(SILENT_AT_LEAST_US, rounds_us), SILENT_AT_MOST_US);
}

// When a member gives up its coordinator: one after the other, so that the first to do so is heard by the
// rest.
static uint64_t take_over_us(const struct ranging* r) {
  return r->heard_us + silence_us(r) + r->us * TAKE_OVER_STEP_US;
}

static uint64_t network_ns(const struct ranging* r, uint64_t ticks) {
  const int64_t since = ticks_until(r->epoch_ticks, ticks);
  return since < 0 ? r->epoch_ns - ticks_to_ns((uint64_t)-since) : r->epoch_ns + ticks_to_ns((uint64_t)since);
}

// Slot 0 was sent or came in at `stamp`.
static void set_round(struct ranging* r, uint64_t stamp) {
  const struct hal* hal = r->radio->hal;
  const uint64_t since_us = ticks_to_ns(ticks_between(stamp, dw1000_now(r->radio))) / 1000;
  r->round_ticks = stamp;
  r->round_us = hal->now_us(hal->board) - since_us;
}

// --- States

static void discover(struct ranging* r) {
  // Long enough for three rounds of the largest network, and different for each node.
  const uint32_t least_us = 3 * timetable_round_us(r->settings.scheme, FRAME_MEMBERS - 1);
  r->state = RANGING_DISCOVERING;
  r->scheme = r->settings.scheme;
  r->deadline_us = r->now_us + least_us + draw(r, least_us);
}

// The next round of our own begins in FIRST_ROUND_US.
static void begin_rounds(struct ranging* r) {
  r->state = RANGING_COORDINATING;
  r->us = 0;
  r->rest_us = 0;
  r->joining = false;
  r->joined_count = 0;
  r->slot = slots(r);
  const uint32_t before_us = round_us(r);
  r->round_us = r->now_us + FIRST_ROUND_US - before_us;
  r->round_ticks = (dw1000_now(r->radio) + ticks_of_us(FIRST_ROUND_US) - ticks_of_us(before_us)) & TICKS_MASK;
  r->joining_us = r->now_us;
  exchange_reset(&r->exchange);
}

// No two alike, as good as: of a thousand networks' names two coincide once in ten thousand times. The mixing
// is that of MurmurHash3 (Appleby 2011).
static uint32_t mixed(uint32_t x) {
  x = (x ^ x >> 16) * 0x85EBCA6BU;
  x = (x ^ x >> 13) * 0xC2B2AE35U;
  return x ^ x >> 16;
}

static void begin_epoch(struct ranging* r) {
  const struct ranging_settings* s = &r->settings;
  r->epoch = mixed(mixed(mixed(s->address + 1U) ^ s->restarts) ^ s->epochs);
  ++r->settings.epochs;
}

static void begin_network(struct ranging* r) {
  roster_begin(&r->roster, r->settings.address, r->now_us);
  r->scheme = r->settings.scheme;
  begin_epoch(r);
  r->epoch_ticks = dw1000_now(r->radio);
  r->epoch_ns = 0;
  begin_rounds(r);
}

// After a coordinator that said that it leaves nobody else goes on by its clock. One that is silent may be
// out of reach alone: time runs on, by a clock of another name.
static void take_over(struct ranging* r, bool silent) {
  if (silent) begin_epoch(r);
  roster_take_over(&r->roster, r->us, r->now_us);
  begin_rounds(r);
}

static void leave_now(struct ranging* r) {
  r->state = RANGING_LEFT;
  dw1000_idle(r->radio);
}

static void join(struct ranging* r, const struct frame* poll) {
  r->state = RANGING_JOINING;
  r->roster_found = poll->roster;
  r->tries = 0;
  r->backoff = 0;
  if (r->leaving) leave_now(r);
}

// --- Sending

static void send(struct ranging* r, struct frame* frame, enum ranging_waiting what, uint64_t at,
                 uint64_t at_us) {
  uint8_t bytes[FRAME_MAX];
  frame->pan = r->settings.pan;
  frame->from = r->settings.address;
  frame->sequence = ++r->sequence;
  frame->sent = dw1000_stamp_of(r->radio, at);
  if (what == WAITING_POLL) frame->plan.time_ns = network_ns(r, frame->sent);
  const size_t size = frame_write(frame, bytes);
  if (size == 0 || dw1000_send_at(r->radio, at, bytes, size, true) != DW1000_OK) {
    dw1000_listen(r->radio, 0);
    return;
  }
  r->waiting = what;
  r->last_word = frame->leaving;
  r->sent = frame->sent;
  r->deadline_us = at_us + SENT_WITHIN_US;
}

static struct frame word(const struct ranging* r, unsigned slot) {
  const int to = timetable_addressee(r->scheme, r->roster.members, slot);
  struct frame frame = {
      .kind = FRAME_WORD,
      .to = to == TIMETABLE_NOBODY ? FRAME_EVERYBODY : r->roster.member[to].address,
      .roster = r->roster.version,
      .round = r->round,
      .slot = (uint8_t)slot,
      .leaving = r->leaving,
  };
  exchange_tell(&r->exchange, &frame);
  return frame;
}

static void send_word(struct ranging* r) {
  const unsigned slot = r->slot;
  const uint32_t in_us = in_round_us(r, slot);
  struct frame frame = word(r, slot);
  r->slot = own_slot(r, slot + 1);
  send(r, &frame, WAITING_WORD, ticks_after(r->round_ticks, ticks_of_us(in_us)), r->round_us + in_us);
}

// Between two rounds: who left or fell silent goes, who asked comes.
static void renew_roster(struct ranging* r) {
  const uint64_t patience_us = later_of(MEMBER_SILENT_US, silence_us(r));
  bool changed = roster_drop(&r->roster, r->now_us > patience_us ? r->now_us - patience_us : 0);
  for (unsigned i = 0; i < r->joined_count; ++i) changed |= roster_add(&r->roster, r->joined[i], r->now_us);
  r->joined_count = 0;
  if (changed) exchange_reset(&r->exchange);
}

static void begin_round(struct ranging* r) {
  const uint32_t before_us = round_us(r);
  const uint64_t at = ticks_after(r->round_ticks, ticks_of_us(before_us));
  const uint64_t at_us = r->round_us + before_us;
  renew_roster(r);
  r->joining =
      r->roster.members < FRAME_MEMBERS - 1 && (r->roster.members == 0 || r->now_us >= r->joining_us);
  if (r->joining) r->joining_us = r->now_us + JOIN_EVERY_US / 2 + draw(r, JOIN_EVERY_US);
  r->rest_us = 0;
  if (r->joining) {
    const uint32_t least_us = in_round_us(r, slots(r) + RANGING_JOIN_SLOTS);
    const uint32_t has_us = round_us(r);
    r->rest_us = least_us > has_us ? least_us - has_us : 0;
  }
  // Two who coordinate nobody and speak at the same time would never hear each other.
  if (r->roster.members == 0) r->rest_us += draw(r, timetable_slot_us(r->scheme));

  ++r->round;
  struct frame frame = word(r, 0);
  frame.has_plan = true;
  frame.plan.epoch = r->epoch;
  frame.plan.scheme = r->scheme;
  frame.plan.joining = r->joining;
  roster_tell(&r->roster, &frame.plan);
  r->slot = own_slot(r, 1);
  r->round_ticks = at;
  r->round_us = at_us;
  send(r, &frame, WAITING_POLL, at, at_us);
  if (r->waiting != WAITING_POLL) begin_rounds(r);  // too late: a fresh start
}

// Asks to be taken up in one of the slots after this round, unless its turn to be silent.
static void ask_to_join(struct ranging* r) {
  if (r->backoff > 0) {
    --r->backoff;
    return;
  }
  ++r->tries;
  const uint32_t most = r->tries < 4 ? 1U << r->tries : MOST_BACKOFF;
  r->backoff = (uint8_t)draw(r, most);
  const unsigned slot = slots(r) + draw(r, RANGING_JOIN_SLOTS);
  const uint32_t in_us = in_round_us(r, slot);
  struct frame frame = {.kind = FRAME_JOIN, .to = r->roster.member[0].address};
  send(r, &frame, WAITING_JOIN, ticks_after(r->round_ticks, ticks_of_us(in_us)), r->round_us + in_us);
}

static void on_sent(struct ranging* r, uint64_t stamp) {
  const enum ranging_waiting what = r->waiting;
  r->waiting = WAITING_NOTHING;
  if (what == WAITING_NOTHING || what == WAITING_JOIN) return;
  if (what == WAITING_POLL) {
    r->epoch_ns = network_ns(r, r->sent);
    r->epoch_ticks = r->sent;
    set_round(r, r->sent);
  }
  if (stamp == r->sent) {
    exchange_sent(&r->exchange, r->sequence, stamp);
  } else {
    exchange_reset(&r->exchange);  // what the frame said of itself was not so
  }
  if (r->last_word) leave_now(r);
}

// --- Receiving

static bool other_is_stronger(const struct ranging* r, const struct frame* poll) {
  if (poll->plan.members != r->roster.members) return poll->plan.members > r->roster.members;
  return poll->from < r->settings.address;
}

// Whether the network whose plan this is shall be ours.
static bool follows(const struct ranging* r, const struct frame* poll) {
  switch (r->state) {
    case RANGING_DISCOVERING:
      return true;
    case RANGING_COORDINATING:
      return other_is_stronger(r, poll);
    case RANGING_JOINING:
    case RANGING_MEMBER:
      return poll->from == r->roster.member[0].address || r->roster.member[0].gone ||
             r->now_us - r->roster.member[0].heard_us > silence_us(r);
    case RANGING_LEFT:
      break;
  }
  return false;
}

static void on_poll(struct ranging* r, const struct frame* poll, uint64_t stamp) {
  if (!follows(r, poll)) return;
  if (r->state == RANGING_DISCOVERING || r->state == RANGING_COORDINATING) join(r, poll);
  const bool other = poll->from != r->roster.member[0].address || poll->roster != r->roster.version;
  const bool after_silence = r->now_us - r->roster.member[0].heard_us > silence_us(r);
  if (other || after_silence || poll->plan.epoch != r->epoch) exchange_reset(&r->exchange);

  roster_follow(&r->roster, poll->from, poll->roster, &poll->plan, r->now_us);
  r->scheme = poll->plan.scheme;
  r->epoch = poll->plan.epoch;
  r->epoch_ticks = stamp;
  r->epoch_ns = poll->plan.time_ns;
  r->heard_us = r->now_us;
  r->round = poll->round;
  r->joining = poll->plan.joining;
  set_round(r, stamp);

  const int us = roster_find(&r->roster, r->settings.address);
  // The same list as when we came may have us in it from before we started: by then our clock was another.
  if (us > 0 && (r->state == RANGING_MEMBER || poll->roster != r->roster_found)) {
    r->state = RANGING_MEMBER;
    r->us = (uint8_t)us;
    r->slot = own_slot(r, 1);
    return;
  }
  if (r->state == RANGING_MEMBER) join(r, poll);
}

static void on_word(struct ranging* r, const struct frame* frame, const struct ranging_event* event,
                    struct ranging_result* result, bool* found) {
  const int peer = frame->roster == r->roster.version ? roster_find(&r->roster, frame->from) : -1;
  if (peer < 0) return;
  r->heard_us = r->now_us;
  struct roster_member* member = &r->roster.member[peer];
  member->heard_us = r->now_us;
  member->gone |= frame->leaving;
  if (r->state != RANGING_MEMBER && r->state != RANGING_COORDINATING) return;
  if (frame->leaving && peer == 0 && r->us == 1) {
    take_over(r, false);
    return;
  }

  // Polled one after the other, as in the paper, nobody listens to what is meant for others.
  if (r->scheme == SCHEME_POLLING && frame->to != r->settings.address) return;
  struct twr_stamps stamps;
  int16_t power_cdbm;
  int32_t time_of_flight;
  if (!exchange_received(&r->exchange, r->us, (unsigned)peer, frame, event->stamp, event->rx_power_cdbm,
                         &stamps,
                         &power_cdbm) ||
      r->us < peer ||  // each distance is told once, by the one who comes later in the roster
      !twr_time_of_flight(&stamps, &time_of_flight)) {
    return;
  }
  *found = true;
  *result = (struct ranging_result){
      .peer = frame->from,
      .overheard = r->scheme == SCHEME_ONE_TO_N && peer != 0,
      .distance_um = twr_distance_um(time_of_flight),
      .rx_power_cdbm = power_cdbm,
      .fp_power_cdbm = event->fp_power_cdbm,
      .clock_ppb = event->clock_ppb,
      .epoch = r->epoch,
      .time_ns = network_ns(r, stamps.second_sent),
  };
}

// Where somebody asks others will: all who start at once would wait for each other.
static void on_join(struct ranging* r, uint16_t from) {
  if (r->joined_count < RANGING_JOIN_SLOTS) r->joined[r->joined_count++] = from;
  r->joining_us = r->now_us;
}

// In the slots to join in it was two who asked at once.
static void on_lost(struct ranging* r) {
  const bool members_are_done = r->now_us >= r->round_us + in_round_us(r, slots(r)) - LEAD_US;
  if (r->state == RANGING_COORDINATING && r->joining && members_are_done) r->joining_us = r->now_us;
}

static void on_received(struct ranging* r, const struct ranging_event* event, struct ranging_result* result,
                        bool* found) {
  struct frame frame;
  if (!frame_read(event->bytes, event->size, &frame) || frame.pan != r->settings.pan ||
      frame.from == r->settings.address) {
    return;
  }
  if (frame.kind == FRAME_JOIN) {
    if (r->state == RANGING_COORDINATING && frame.to == r->settings.address) on_join(r, frame.from);
    return;
  }
  if (r->state == RANGING_DISCOVERING) r->deadline_us = later_of(r->deadline_us, r->now_us + silence_us(r));
  if (frame.has_plan) on_poll(r, &frame, event->stamp);
  on_word(r, &frame, event, result, found);
  if (r->state == RANGING_JOINING && frame.has_plan && r->joining &&
      frame.from == r->roster.member[0].address) {
    ask_to_join(r);
  }
}

// --- Time

static uint64_t next_deadline(const struct ranging* r) {
  if (r->waiting != WAITING_NOTHING) return r->deadline_us;
  const uint64_t own_us = r->slot < slots(r) ? r->round_us + in_round_us(r, r->slot) - LEAD_US : UINT64_MAX;
  switch (r->state) {
    case RANGING_DISCOVERING:
      return r->deadline_us;
    case RANGING_JOINING:
      return r->heard_us + silence_us(r);
    case RANGING_MEMBER:
      return earlier_of(own_us, take_over_us(r));
    case RANGING_COORDINATING:
      return own_us != UINT64_MAX ? own_us : r->round_us + round_us(r) - LEAD_US;
    case RANGING_LEFT:
      break;
  }
  return UINT64_MAX;
}

static void on_deadline(struct ranging* r) {
  if (r->now_us < next_deadline(r)) return;
  if (r->waiting != WAITING_NOTHING) {  // the radio has lost it
    r->waiting = WAITING_NOTHING;
    dw1000_listen(r->radio, 0);
    return;
  }
  switch (r->state) {
    case RANGING_DISCOVERING:
      begin_network(r);
      break;
    case RANGING_JOINING:
      discover(r);
      break;
    case RANGING_MEMBER:
      if (r->now_us >= take_over_us(r)) {
        take_over(r, true);
      } else {
        send_word(r);
      }
      break;
    case RANGING_COORDINATING:
      if (r->slot < slots(r)) {
        send_word(r);
      } else {
        begin_round(r);
      }
      break;
    case RANGING_LEFT:
      break;
  }
}

uint64_t ranging_start(struct ranging* r, struct dw1000* radio, const struct ranging_settings* settings,
                       uint32_t random) {
  *r = (struct ranging){.radio = radio, .settings = *settings, .random = random | 1U};
  r->now_us = radio->hal->now_us(radio->hal->board);
  r->sequence = (uint8_t)draw(r, 256);  // frames from before a restart are not taken for these
  r->roster.version = (uint8_t)draw(r, 256);
  discover(r);
  dw1000_listen(radio, 0);
  return next_deadline(r);
}

uint64_t ranging_on_event(struct ranging* r, const struct ranging_event* event, struct ranging_result* result,
                          bool* found) {
  *found = false;
  r->now_us = r->radio->hal->now_us(r->radio->hal->board);
  switch (event->kind) {
    case RANGING_DEADLINE:
      on_deadline(r);
      break;
    case RANGING_SENT:
      on_sent(r, event->stamp);
      break;
    case RANGING_RECEIVED:
      on_received(r, event, result, found);
      break;
    case RANGING_LOST:
      on_lost(r);
      break;
  }
  const bool receiver_off = event->kind == RANGING_RECEIVED || event->kind == RANGING_LOST;
  if (receiver_off && r->waiting == WAITING_NOTHING && r->state != RANGING_LEFT) dw1000_listen(r->radio, 0);
  return next_deadline(r);
}

void ranging_leave(struct ranging* r) {
  r->leaving = true;
  if (r->state == RANGING_DISCOVERING || r->state == RANGING_JOINING) leave_now(r);
}
