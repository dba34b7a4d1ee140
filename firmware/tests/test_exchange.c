// Which stamps make a range; and that no loss, pause or new beginning of a clock ever makes a wrong one.
#include "check.h"
#include "dw1000.h"
#include "exchange.h"
#include "ticks.h"

#define NODES 3
#define FINE 65536  // of an ideal tick: the unit of simulated time

static const int64_t ms = (int64_t)TICKS_PER_MS * FINE;

struct clock {
  uint64_t offset;  // ticks
  int64_t ppb;
};

static uint64_t read_clock(const struct clock* clock, int64_t at) {
  const int64_t billion = 1000000000;
  const int64_t counted = at + at / billion * clock->ppb + at % billion * clock->ppb / billion;
  return ticks_after(clock->offset, (uint64_t)(counted / FINE));
}

struct world {
  uint64_t random;
  int64_t now;
  int64_t flight[NODES][NODES];  // FINE
  struct clock clock[NODES];
  uint8_t sequence[NODES];
  struct exchange exchange[NODES];
  unsigned sent_since_range[NODES][NODES];  // own frames since the last range with another
  unsigned accepted, refused;
};

static uint64_t random_below(struct world* world, uint64_t limit) {
  world->random = world->random * UINT64_C(6364136223846793005) + 1442695040888963407;
  return (world->random >> 20) % limit;
}

static void begin_anew(struct world* world, unsigned node, uint64_t offset) {
  world->clock[node].offset = offset;
  world->sequence[node] = (uint8_t)random_below(world, 256);
  exchange_reset(&world->exchange[node]);
}

static struct world new_world(uint64_t seed) {
  struct world world = {.random = seed, .now = ms};
  for (unsigned a = 0; a < NODES; ++a) {
    world.clock[a].ppb = (int64_t)random_below(&world, 40001) - 20000;
    begin_anew(&world, a, random_below(&world, TICKS_MASK + 1));
    for (unsigned b = 0; b < a; ++b) {
      world.flight[a][b] = (int64_t)random_below(&world, 64000) * FINE + (int64_t)random_below(&world, FINE);
      world.flight[b][a] = world.flight[a][b];
    }
  }
  return world;
}

// What `to` makes of a frame that came in: true where that is a new range. It must be the true distance to
// within a tick, for each stamp is cut off to whole ones, and 20 ppm of it, for which clock's seconds it is
// measured in.
static bool hears(struct world* world, unsigned to, unsigned from, const struct frame* word) {
  const int64_t flight = world->flight[to][from];
  const uint64_t received = read_clock(&world->clock[to], world->now + flight);
  struct twr_stamps stamps;
  int16_t power = 0;
  int32_t found = 0;
  if (!exchange_received(&world->exchange[to], to, from, word, received, -8000, &stamps, &power))
    return false;
  CHECK(world->sent_since_range[to][from] > 0);
  world->sent_since_range[to][from] = 0;
  if (!twr_time_of_flight(&stamps, &found)) {
    ++world->refused;
    return false;
  }
  ++world->accepted;
  const int64_t exact = flight * TWR_FRACTION / FINE;
  const int64_t allowed = TWR_FRACTION + 1 + exact / 50000;
  CHECK_WITHIN(found, exact - allowed, exact + allowed);
  return true;
}

static struct frame speaks(struct world* world, unsigned from) {
  struct frame word = {.kind = FRAME_WORD, .sequence = ++world->sequence[from]};
  word.sent = read_clock(&world->clock[from], world->now);
  exchange_tell(&world->exchange[from], &word);
  exchange_sent(&world->exchange[from], word.sequence, word.sent);
  for (unsigned i = 0; i < NODES; ++i) ++world->sent_since_range[from][i];
  return word;
}

// `from` speaks now, all hear it; bit i of what comes back: node i has a new range.
static unsigned turn(struct world* world, unsigned from, unsigned nodes) {
  const struct frame word = speaks(world, from);
  unsigned ranges = 0;
  for (unsigned to = 0; to < nodes; ++to) {
    if (to != from && hears(world, to, from, &word)) ranges |= 1U << to;
  }
  world->now += ms;
  return ranges;
}

static void three_frames_make_one_range_for_whom_spoke_second(void) {
  struct world world = new_world(1);
  CHECK_EQUAL(turn(&world, 0, 2), 0);
  CHECK_EQUAL(turn(&world, 1, 2), 0);
  CHECK_EQUAL(turn(&world, 0, 2), 2);
  // And from then on each frame is a third.
  CHECK_EQUAL(turn(&world, 1, 2), 1);
  CHECK_EQUAL(turn(&world, 0, 2), 2);
}

static void poll_answers_and_final_range_all_to_all(void) {
  struct world world = new_world(2);
  for (unsigned round = 0; round < 3; ++round) {
    CHECK_EQUAL(turn(&world, 0, 3), 0);                  // poll
    CHECK_EQUAL(turn(&world, 1, 3), round > 0 ? 5 : 0);  // tells when the poll and number 2's latest came in
    CHECK_EQUAL(turn(&world, 2, 3), round > 0 ? 3 : 0);  // tells when the poll and number 1's came in
    CHECK_EQUAL(turn(&world, 0, 3), 6);                  // final
  }
}

static void in_all_pairs_each_frame_is_a_range_to_everybody_else(void) {
  struct world world = new_world(3);
  turn(&world, 0, 3);
  turn(&world, 1, 3);
  turn(&world, 2, 3);
  for (unsigned i = 3; i < 30; ++i) {
    const unsigned expected = 7U & ~(1U << i % 3);
    // The first round has no frame before the first one's to measure from.
    if (i > 4)
      CHECK_EQUAL(turn(&world, i % 3, 3), expected);
    else
      turn(&world, i % 3, 3);
  }
}

static void stamps_and_power_are_those_of_the_three_frames(void) {
  struct exchange exchange;
  exchange_reset(&exchange);
  struct twr_stamps stamps;
  int16_t power = 0;
  struct frame word = {.kind = FRAME_WORD, .sequence = 9, .sent = 1000};
  CHECK(!exchange_received(&exchange, 2, 5, &word, 2000, -8000, &stamps, &power));

  struct frame told = {0};
  exchange_tell(&exchange, &told);
  CHECK_EQUAL(told.heard, 1U << 5);
  CHECK_EQUAL(told.stamp[5].sequence, 9);
  CHECK_EQUAL(told.stamp[5].received, 2000);

  exchange_sent(&exchange, 77, 3000);
  exchange_tell(&exchange, &told);
  CHECK_EQUAL(told.heard, 0);

  word = (struct frame){
      .kind = FRAME_WORD, .sequence = 10, .sent = 5000, .heard = 1U << 2, .stamp = {[2] = {77, 4000}}};
  CHECK(exchange_received(&exchange, 2, 5, &word, 6000, -8101, &stamps, &power));
  CHECK_EQUAL(stamps.first_sent, 1000);
  CHECK_EQUAL(stamps.first_received, 2000);
  CHECK_EQUAL(stamps.second_sent, 3000);
  CHECK_EQUAL(stamps.second_received, 4000);
  CHECK_EQUAL(stamps.third_sent, 5000);
  CHECK_EQUAL(stamps.third_received, 6000);
  CHECK_WITHIN(power, -8051, -8050);
}

// We are number 1 and have heard number 0, at `power_cdbm`, and sent our frame `sequence`.
static void begin(struct exchange* exchange, uint8_t sequence, int16_t power_cdbm) {
  exchange_reset(exchange);
  struct twr_stamps stamps;
  int16_t power = 0;
  const struct frame first = {.kind = FRAME_WORD, .sent = 0};
  CHECK(!exchange_received(exchange, 1, 0, &first, 100, power_cdbm, &stamps, &power));
  exchange_sent(exchange, sequence, 200);
}

// Does number 0's next frame, sent at `sent`, make a range, telling of the frame `sequence` of number `of`?
static bool tells(struct exchange* exchange, uint64_t sent, unsigned of, uint8_t sequence, int16_t power_cdbm,
                  int16_t* power) {
  struct frame word = {.kind = FRAME_WORD, .sent = sent, .heard = (uint16_t)(1U << of)};
  word.stamp[of] = (struct frame_stamp){sequence, 300};
  struct twr_stamps stamps;
  return exchange_received(exchange, 1, 0, &word, sent + 100, power_cdbm, &stamps, power);
}

static void only_a_frame_that_tells_of_our_latest_counts(void) {
  struct exchange exchange;
  int16_t power = 0;
  begin(&exchange, 8, -7000);
  CHECK(!tells(&exchange, 350, 1, 7, -7000, &power));
  CHECK(!tells(&exchange, 360, 2, 8, -7000, &power));
  CHECK(tells(&exchange, 370, 1, 8, -7000, &power));
  begin(&exchange, 0, -7000);
  CHECK(!tells(&exchange, 350, 2, 0, -7000, &power));
  CHECK(tells(&exchange, 360, 1, 0, -7000, &power));
}

static void told_of_twice_our_frame_makes_one_range(void) {
  struct exchange exchange;
  int16_t power = 0;
  begin(&exchange, 8, -7000);
  CHECK(tells(&exchange, 350, 1, 8, -7000, &power));
  CHECK(!tells(&exchange, 360, 1, 8, -7000, &power));
}

static void an_unknown_power_stays_unknown(void) {
  struct exchange exchange;
  int16_t power = 0;
  begin(&exchange, 8, DW1000_UNKNOWN_POWER);
  CHECK(tells(&exchange, 350, 1, 8, -7000, &power));
  CHECK_EQUAL(power, DW1000_UNKNOWN_POWER);
  begin(&exchange, 8, -7000);
  CHECK(tells(&exchange, 350, 1, 8, DW1000_UNKNOWN_POWER, &power));
  CHECK_EQUAL(power, DW1000_UNKNOWN_POWER);
}

static void a_frame_heard_twice_makes_one_range(void) {
  struct world world = new_world(4);
  turn(&world, 0, 2);
  turn(&world, 1, 2);
  const struct frame third = speaks(&world, 0);
  CHECK(hears(&world, 1, 0, &third));
  CHECK(!hears(&world, 1, 0, &third));
  world.now += ms;
  CHECK(!hears(&world, 1, 0, &third));
  CHECK_EQUAL(turn(&world, 1, 2), 1);
  CHECK_EQUAL(turn(&world, 0, 2), 2);
  CHECK_EQUAL(world.refused, 0);
}

static void a_lost_third_is_made_up_by_none_that_does_not_tell(void) {
  struct world world = new_world(5);
  turn(&world, 0, 2);
  turn(&world, 1, 2);
  speaks(&world, 0);  // nobody hears it, and the next tells nothing
  world.now += ms;
  CHECK_EQUAL(turn(&world, 0, 2), 0);
  turn(&world, 1, 2);
  CHECK_EQUAL(turn(&world, 0, 2), 2);
}

static void a_reset_forgets_all(void) {
  struct world world = new_world(6);
  turn(&world, 0, 2);
  turn(&world, 1, 2);
  exchange_reset(&world.exchange[1]);
  CHECK_EQUAL(turn(&world, 0, 2), 0);
  struct frame told = {0};
  exchange_reset(&world.exchange[1]);
  exchange_tell(&world.exchange[1], &told);
  CHECK_EQUAL(told.heard, 0);
}

static void numbers_beyond_the_roster_are_nobody(void) {
  struct exchange exchange;
  exchange_reset(&exchange);
  const struct frame word = {.kind = FRAME_WORD};
  struct twr_stamps stamps;
  int16_t power = 0;
  CHECK(!exchange_received(&exchange, 0, FRAME_MEMBERS, &word, 0, 0, &stamps, &power));
  CHECK(!exchange_received(&exchange, FRAME_MEMBERS, 0, &word, 0, 0, &stamps, &power));
  CHECK(!exchange_received(&exchange, 3, 3, &word, 0, 0, &stamps, &power));
  struct frame told = {0};
  exchange_tell(&exchange, &told);
  CHECK_EQUAL(told.heard, 0);
}

static void a_peer_whose_clock_began_anew_gives_no_range(void) {
  struct world world = new_world(7);
  turn(&world, 0, 2);
  turn(&world, 1, 2);
  // It starts again and happens to go on with its sequence and to have heard us: still no range.
  struct frame word = speaks(&world, 0);
  world.clock[0].offset = 12345;
  word.sent = read_clock(&world.clock[0], world.now);
  word.stamp[1].received = ticks_after(word.sent, (uint64_t)0 - TICKS_PER_MS);
  CHECK(!hears(&world, 1, 0, &word));
  CHECK_EQUAL(world.refused, 1);
}

// Clocks a tenth of a ppm apart differ so little after a wrap that its stamps look like those of a moment
// ago.
static void a_peer_heard_again_after_a_wrap_gives_no_range(void) {
  struct world world = new_world(8);
  world.clock[0].ppb = 0;
  world.clock[1].ppb = 100;
  turn(&world, 0, 2);
  const int64_t wrap = (int64_t)(TICKS_MASK + 1) * FINE;
  for (unsigned i = 0; i < 59; ++i) {
    world.now += wrap / 60;
    speaks(&world, 1);
  }
  world.now += wrap / 60;
  turn(&world, 1, 2);
  CHECK_EQUAL(turn(&world, 0, 2), 0);
  CHECK_EQUAL(world.refused, 0);
  turn(&world, 1, 2);
  CHECK_EQUAL(turn(&world, 0, 2), 2);
}

static void a_first_frame_is_kept_over_a_polling_round(void) {
  struct world world = new_world(9);
  turn(&world, 1, 2);
  for (unsigned i = 0; i < 20; ++i) turn(&world, 0, 2);
  CHECK_EQUAL(turn(&world, 1, 2), 1);
}

// Turns at random, 0 to 60 % of the frames lost, pairs that do not hear each other for a while, nodes that
// begin anew, at any moment of their clock or at 0.
static void no_range_is_ever_wrong(void) {
  unsigned accepted = 0, refused = 0;
  for (unsigned run = 0; run < 50; ++run) {
    struct world world = new_world(1000 + run);
    const unsigned nodes = 2 + run % 2;
    const uint64_t lost_of_ten = run % 7;
    int64_t deaf_until[NODES] = {0};  // by the one of three nodes that the pair lacks
    if (run % 5 == 0) {
      for (unsigned i = 0; i < nodes; ++i) world.clock[i].ppb /= 100;
    }
    for (unsigned i = 0; i < 1000; ++i) {
      const unsigned from = (unsigned)random_below(&world, nodes);
      const struct frame word = speaks(&world, from);
      for (unsigned to = 0; to < nodes; ++to) {
        if (to == from || deaf_until[3 - to - from] > world.now) continue;
        if (random_below(&world, 10) >= lost_of_ten) hears(&world, to, from, &word);
      }
      const uint64_t what_next = random_below(&world, 100);
      if (what_next == 0) begin_anew(&world, from, random_below(&world, TICKS_MASK + 1));
      if (what_next == 1) begin_anew(&world, from, (uint64_t)0 - (uint64_t)(world.now / FINE));
      if (what_next == 2)
        deaf_until[random_below(&world, NODES)] = world.now + (int64_t)random_below(&world, 20000) * ms;
      world.now += ms / 4 + (int64_t)random_below(&world, what_next < 20 ? 400 * 1000 : 3000) * (ms / 1000);
    }
    accepted += world.accepted;
    refused += world.refused;
  }
  CHECK_WITHIN(accepted, 5000, 20000);
  CHECK_WITHIN(refused, 100, 3000);
}

int main(void) {
  three_frames_make_one_range_for_whom_spoke_second();
  poll_answers_and_final_range_all_to_all();
  in_all_pairs_each_frame_is_a_range_to_everybody_else();
  stamps_and_power_are_those_of_the_three_frames();
  only_a_frame_that_tells_of_our_latest_counts();
  told_of_twice_our_frame_makes_one_range();
  an_unknown_power_stays_unknown();
  a_frame_heard_twice_makes_one_range();
  a_lost_third_is_made_up_by_none_that_does_not_tell();
  a_reset_forgets_all();
  numbers_beyond_the_roster_are_nobody();
  a_peer_whose_clock_began_anew_gives_no_range();
  a_peer_heard_again_after_a_wrap_gives_no_range();
  a_first_frame_is_kept_over_a_polling_round();
  no_range_is_ever_wrong();
  return check_verdict();
}
