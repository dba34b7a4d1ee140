// What is said on the air, byte by byte.
#include <string.h>

#include "check.h"
#include "frame.h"
#include "ticks.h"

// The coordinator 0x1234 of PAN 0xBEEF heard members 1 and 3 and says the plan for three.
static const uint8_t plan_bytes[] = {
    0x41, 0x88, 0x07, 0xEF, 0xBE, 0xFF, 0xFF, 0x34, 0x12,              // header
    0x01, 0x05, 0x2A, 0x01, 0x02, 0x00, 0x55, 0x44, 0x33, 0x22, 0x11,  // word
    0x0A, 0x00,                                                        // heard
    0x63, 0x01, 0x00, 0x00, 0x00, 0x80,                                // number 1
    0x64, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF,                                // number 3
    0x04, 0x03, 0x02, 0x01,                                            // epoch
    0x08, 0x07, 0x06, 0x05, 0x04, 0x03, 0x02, 0x01,                    // time
    0x01, 0x03, 0x01, 0x00, 0x02, 0x00, 0xFD, 0xFF,                    // all pairs, three members
};

static struct frame plan_frame(void) {
  return (struct frame){
      .kind = FRAME_WORD,
      .sequence = 7,
      .pan = 0xBEEF,
      .to = FRAME_EVERYBODY,
      .from = 0x1234,
      .roster = 42,
      .round = 0x0201,
      .sent = UINT64_C(0x1122334455),
      .heard = 0x000A,
      .stamp = {[1] = {99, UINT64_C(0x8000000001)}, [3] = {100, TICKS_MASK}},
      .has_plan = true,
      .plan = {.epoch = 0x01020304,
               .time_ns = UINT64_C(0x0102030405060708),
               .scheme = 1,
               .joining = true,
               .members = 3,
               .member = {1, 2, 0xFFFD}},
  };
}

static struct frame full_frame(void) {
  struct frame frame = plan_frame();
  frame.heard = 0x7FE;
  for (unsigned i = 1; i < FRAME_MEMBERS; ++i)
    frame.stamp[i] = (struct frame_stamp){(uint8_t)i, i * UINT64_C(0x10F0F0F0F)};
  frame.plan.members = FRAME_MEMBERS - 1;
  for (unsigned i = 0; i < FRAME_MEMBERS - 1; ++i) frame.plan.member[i] = (uint16_t)(100 + i);
  return frame;
}

static bool refused(const uint8_t* bytes, size_t size) {
  struct frame frame;
  return !frame_read(bytes, size, &frame);
}

// As refused, with one byte of the stored frame changed.
static bool refused_with(size_t at, uint8_t value) {
  uint8_t bytes[sizeof plan_bytes];
  memcpy(bytes, plan_bytes, sizeof bytes);
  bytes[at] = value;
  return refused(bytes, sizeof bytes);
}

static void a_word_with_a_plan_has_its_bytes(void) {
  const struct frame frame = plan_frame();
  uint8_t bytes[FRAME_MAX];
  CHECK_EQUAL(frame_write(&frame, bytes), sizeof plan_bytes);
  CHECK_EQUAL(memcmp(bytes, plan_bytes, sizeof plan_bytes), 0);
}

static void a_word_with_a_plan_is_read(void) {
  struct frame frame;
  CHECK(frame_read(plan_bytes, sizeof plan_bytes, &frame));
  CHECK_EQUAL(frame.kind, FRAME_WORD);
  CHECK_EQUAL(frame.sequence, 7);
  CHECK_EQUAL(frame.pan, 0xBEEF);
  CHECK_EQUAL(frame.to, FRAME_EVERYBODY);
  CHECK_EQUAL(frame.from, 0x1234);
  CHECK_EQUAL(frame.roster, 42);
  CHECK_EQUAL(frame.round, 0x0201);
  CHECK_EQUAL(frame.slot, 0);
  CHECK(!frame.leaving);
  CHECK_EQUAL(frame.sent, INT64_C(0x1122334455));
  CHECK_EQUAL(frame.heard, 0x000A);
  CHECK_EQUAL(frame.stamp[1].sequence, 99);
  CHECK_EQUAL(frame.stamp[1].received, INT64_C(0x8000000001));
  CHECK_EQUAL(frame.stamp[3].sequence, 100);
  CHECK_EQUAL(frame.stamp[3].received, INT64_C(0xFFFFFFFFFF));
  CHECK(frame.has_plan);
  CHECK_EQUAL(frame.plan.epoch, 0x01020304);
  CHECK_EQUAL(frame.plan.time_ns, INT64_C(0x0102030405060708));
  CHECK_EQUAL(frame.plan.scheme, 1);
  CHECK(frame.plan.joining);
  CHECK_EQUAL(frame.plan.members, 3);
  CHECK_EQUAL(frame.plan.member[0], 1);
  CHECK_EQUAL(frame.plan.member[1], 2);
  CHECK_EQUAL(frame.plan.member[2], 0xFFFD);
}

static void a_wish_to_join_is_a_header_and_a_kind(void) {
  const uint8_t join_bytes[] = {0x41, 0x88, 0xFF, 0x01, 0x00, 0x02, 0x00, 0x03, 0x00, 0x02};
  const struct frame join = {.kind = FRAME_JOIN, .sequence = 255, .pan = 1, .to = 2, .from = 3};
  uint8_t bytes[FRAME_MAX];
  CHECK_EQUAL(frame_write(&join, bytes), sizeof join_bytes);
  CHECK_EQUAL(memcmp(bytes, join_bytes, sizeof join_bytes), 0);

  struct frame frame;
  CHECK(frame_read(join_bytes, sizeof join_bytes, &frame));
  CHECK_EQUAL(frame.kind, FRAME_JOIN);
  CHECK_EQUAL(frame.sequence, 255);
  CHECK_EQUAL(frame.to, 2);
  CHECK_EQUAL(frame.from, 3);
  CHECK(refused(join_bytes, sizeof join_bytes - 1));
}

static void the_last_word_says_so(void) {
  const struct frame last = {.kind = FRAME_WORD, .to = FRAME_EVERYBODY, .leaving = true};
  uint8_t bytes[FRAME_MAX];
  CHECK_EQUAL(frame_write(&last, bytes), 22);
  CHECK_EQUAL(bytes[10], 2);
  struct frame frame;
  CHECK(frame_read(bytes, 22, &frame));
  CHECK(frame.leaving);
  CHECK(!frame.has_plan);
}

static void the_biggest_network_fits(void) {
  struct frame frame = full_frame();
  uint8_t bytes[FRAME_MAX];
  CHECK_EQUAL(frame_write(&frame, bytes), 116);
  CHECK(!refused(bytes, 116));
  frame.heard = 0x7FF;
  CHECK_EQUAL(frame_write(&frame, bytes), 122);
  CHECK(!refused(bytes, 122));
}

static void a_frame_cut_off_anywhere_is_refused(void) {
  for (size_t size = 0; size < sizeof plan_bytes; ++size) CHECK(refused(plan_bytes, size));
}

static void a_frame_with_more_behind_it_is_refused(void) {
  uint8_t bytes[FRAME_MAX] = {0};
  memcpy(bytes, plan_bytes, sizeof plan_bytes);
  for (size_t size = sizeof plan_bytes + 1; size <= FRAME_MAX; ++size) CHECK(refused(bytes, size));
}

static void another_kind_of_frame_is_refused(void) {
  CHECK(refused_with(0, 0x61));  // asks for an acknowledgement
  CHECK(refused_with(1, 0x98));  // of another version of the standard
  CHECK(refused_with(9, 0));
  CHECK(refused_with(9, 3));
  CHECK(refused_with(9, 0x81));
  const uint8_t blink[] = {0xC5, 0x01, 1, 2, 3, 4, 5, 6, 7, 8};
  CHECK(refused(blink, sizeof blink));
}

static void flags_that_say_nothing_are_refused(void) {
  for (unsigned bit = 3; bit < 8; ++bit) CHECK(refused_with(10, (uint8_t)(0x05 | 1U << bit)));
  const uint8_t joining_without_plan[] = {0x41, 0x88, 0, 0, 0, 0, 0, 0, 0, 1, 4,
                                          0,    0,    0, 0, 0, 0, 0, 0, 0, 0, 0};
  CHECK(refused(joining_without_plan, sizeof joining_without_plan));
}

static void nobody_speaks_as_everybody(void) {
  struct frame frame = plan_frame();
  frame.plan.members = 2;
  uint8_t bytes[FRAME_MAX];
  for (uint16_t from = FRAME_LAST_ADDRESS; from != 0; ++from) {
    frame.from = from;
    CHECK_EQUAL(frame_write(&frame, bytes), from == FRAME_LAST_ADDRESS ? sizeof plan_bytes - 2 : 0);
    memcpy(bytes, plan_bytes, sizeof plan_bytes);
    bytes[47] = 2;
    memcpy(bytes + 7, (const uint8_t[]){(uint8_t)from, (uint8_t)(from >> 8)}, 2);
    CHECK_EQUAL(refused(bytes, sizeof plan_bytes - 2), from != FRAME_LAST_ADDRESS);
  }
}

static void numbers_beyond_the_roster_are_refused(void) {
  // Bit 11 says that another stamp follows, and there are six bytes that could be one.
  uint8_t bytes[sizeof plan_bytes + 6];
  memcpy(bytes, plan_bytes, 34);
  memset(bytes + 34, 0, 6);
  memcpy(bytes + 40, plan_bytes + 34, sizeof plan_bytes - 34);
  bytes[20] = 0x1A;
  CHECK(!refused(bytes, sizeof bytes));  // a member
  bytes[20] = 0x0A;
  for (unsigned bit = 3; bit < 8; ++bit) {
    bytes[21] = (uint8_t)(1U << bit);
    CHECK(refused(bytes, sizeof bytes));
    CHECK(refused_with(21, bytes[21]));
  }
}

static void more_members_than_a_network_has_are_refused(void) {
  struct frame frame = full_frame();
  uint8_t bytes[FRAME_MAX + 3] = {0};
  const size_t size = frame_write(&frame, bytes);
  bytes[size - 21] = FRAME_MEMBERS;
  CHECK(refused(bytes, size));
  CHECK(refused(bytes, size + 2));
  bytes[size - 21] = 255;
  CHECK(refused(bytes, size));
}

static void an_unknown_scheme_is_refused(void) {
  CHECK(!refused_with(46, 2));
  CHECK(refused_with(46, 3));
  CHECK(refused_with(46, 255));
}

static void a_plan_in_the_middle_of_a_round_is_refused(void) { CHECK(refused_with(14, 1)); }

static void a_plan_that_names_somebody_twice_is_refused(void) {
  CHECK(refused_with(48, 2));  // the first member is the second one too
  uint8_t bytes[FRAME_MAX];
  struct frame frame = plan_frame();
  frame.plan.member[1] = frame.from;
  CHECK_EQUAL(frame_write(&frame, bytes), 0);
}

static void a_time_beyond_all_clocks_is_refused(void) {
  CHECK(!refused_with(45, 0x3F));
  CHECK(refused_with(45, 0x41));
}

static void what_cannot_be_said_is_not_written(void) {
  uint8_t bytes[FRAME_MAX];
  struct frame frame = plan_frame();
  frame.kind = 0;
  CHECK_EQUAL(frame_write(&frame, bytes), 0);
  frame = plan_frame();
  frame.sent = TICKS_MASK + 1;
  CHECK_EQUAL(frame_write(&frame, bytes), 0);
  frame = plan_frame();
  frame.stamp[3].received = TICKS_MASK + 1;
  CHECK_EQUAL(frame_write(&frame, bytes), 0);
  frame = plan_frame();
  frame.heard = 1U << FRAME_MEMBERS;
  CHECK_EQUAL(frame_write(&frame, bytes), 0);
  frame = plan_frame();
  frame.plan.members = FRAME_MEMBERS;
  CHECK_EQUAL(frame_write(&frame, bytes), 0);
  frame = plan_frame();
  frame.plan.scheme = 3;
  CHECK_EQUAL(frame_write(&frame, bytes), 0);
  frame = plan_frame();
  frame.plan.member[2] = FRAME_EVERYBODY;
  CHECK_EQUAL(frame_write(&frame, bytes), 0);
}

static void what_is_not_told_is_not_looked_at(void) {
  uint8_t bytes[FRAME_MAX];
  struct frame frame = plan_frame();
  frame.stamp[2].received = UINT64_MAX;
  frame.plan.member[3] = FRAME_EVERYBODY;
  CHECK_EQUAL(frame_write(&frame, bytes), sizeof plan_bytes);
  frame.has_plan = false;
  frame.plan.members = 255;
  CHECK_EQUAL(frame_write(&frame, bytes), 34);
  CHECK_EQUAL(bytes[10], 0);
}

// No two rows of bytes mean the same: whatever is read is written as it was.
static void damaged_frames_are_refused_or_read_as_they_are(void) {
  uint32_t state = 1;
  unsigned taken = 0;
  for (unsigned i = 0; i < 20000; ++i) {
    uint8_t bytes[sizeof plan_bytes];
    memcpy(bytes, plan_bytes, sizeof bytes);
    for (unsigned changes = 0; changes < 2; ++changes) {
      state = state * 1664525 + 1013904223;
      bytes[(state >> 24) % sizeof bytes] ^= (uint8_t)(1U << (state >> 21 & 7));
    }
    struct frame frame;
    if (!frame_read(bytes, sizeof bytes, &frame)) continue;
    ++taken;
    uint8_t again[FRAME_MAX];
    CHECK_EQUAL(frame_write(&frame, again), sizeof bytes);
    CHECK_EQUAL(memcmp(again, bytes, sizeof bytes), 0);
  }
  CHECK_WITHIN(taken, 2000, 18000);
}

int main(void) {
  a_word_with_a_plan_has_its_bytes();
  a_word_with_a_plan_is_read();
  a_wish_to_join_is_a_header_and_a_kind();
  the_last_word_says_so();
  the_biggest_network_fits();
  a_frame_cut_off_anywhere_is_refused();
  a_frame_with_more_behind_it_is_refused();
  another_kind_of_frame_is_refused();
  flags_that_say_nothing_are_refused();
  nobody_speaks_as_everybody();
  numbers_beyond_the_roster_are_refused();
  more_members_than_a_network_has_are_refused();
  an_unknown_scheme_is_refused();
  a_plan_in_the_middle_of_a_round_is_refused();
  a_plan_that_names_somebody_twice_is_refused();
  a_time_beyond_all_clocks_is_refused();
  what_cannot_be_said_is_not_written();
  what_is_not_told_is_not_looked_at();
  damaged_frames_are_refused_or_read_as_they_are();
  return check_verdict();
}
