#include "check.h"
#include "outbox.h"

#define SENT_ROOM 16

// A network that takes datagrams or does not.
struct network {
  bool down;
  unsigned tried, count;
  struct wire_ranges sent[SENT_ROOM];
};

static const uint8_t key[WIRE_KEY_SIZE] = {1, 2, 3};

static bool send(void* board, const uint8_t* datagram, size_t size) {
  struct network* const network = board;
  ++network->tried;
  if (network->down || network->count == SENT_ROOM) return false;
  CHECK(wire_read_ranges(datagram, size, key, &network->sent[network->count]));
  ++network->count;
  return true;
}

static struct outbox_range range_at(uint64_t at_us) {
  return (struct outbox_range){
      .at_us = at_us,
      .epoch = 77,
      .time_ns = 5000000000 + at_us * 1000,
      .range = {.peer = 9,
                .distance_mm = (int32_t)at_us,
                .sigma_mm = 30,
                .rx_power_cdbm = WIRE_UNKNOWN_POWER,
                .fp_power_cdbm = WIRE_UNKNOWN_POWER,
                .clock_ppb = WIRE_UNKNOWN_CLOCK},
  };
}

static void put_at(struct outbox* outbox, uint64_t at_us) {
  const struct outbox_range range = range_at(at_us);
  outbox_put(outbox, &range);
}

static void ranges_wait_for_others_and_go_together(void) {
  struct network network = {0};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 0xAABBCCDD, 7, 3);
  CHECK(outbox_send(&outbox, &hal, key, 0, false) == UINT64_MAX);
  put_at(&outbox, 1000);
  put_at(&outbox, 4000);
  CHECK_EQUAL(outbox_send(&outbox, &hal, key, 4000, false), 21000);
  CHECK_EQUAL(outbox_send(&outbox, &hal, key, 20999, false), 21000);
  CHECK_EQUAL(network.tried, 0);
  CHECK(outbox_send(&outbox, &hal, key, 21000, false) == UINT64_MAX);
  CHECK_EQUAL(network.count, 1);
  const struct wire_ranges* const sent = &network.sent[0];
  CHECK_EQUAL(sent->session, 0xAABBCCDD);
  CHECK_EQUAL(sent->reporter, 7);
  CHECK_EQUAL(sent->sequence, UINT64_C(3) << 32);
  CHECK_EQUAL(sent->epoch, 77);
  CHECK_EQUAL(sent->time_ns, 5001000000);
  CHECK_EQUAL(sent->dropped, 0);
  CHECK_EQUAL(sent->count, 2);
  CHECK_EQUAL(sent->range[0].offset_us, 0);
  CHECK_EQUAL(sent->range[1].offset_us, 3000);
  CHECK_EQUAL(sent->range[1].distance_mm, 4000);
}

static void sequences_rise_with_each_datagram_and_over_restarts(void) {
  struct network network = {0};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 0);
  for (uint64_t at = 0; at < 3; ++at) {
    put_at(&outbox, at);
    outbox_send(&outbox, &hal, key, at, true);
  }
  outbox_start(&outbox, 1, 7, 1);
  put_at(&outbox, 0);
  outbox_send(&outbox, &hal, key, 0, true);
  CHECK_EQUAL(network.count, 4);
  for (unsigned i = 0; i < 3; ++i) CHECK_EQUAL(network.sent[i].sequence, i);
  CHECK_EQUAL(network.sent[3].sequence, UINT64_C(1) << 32);
}

static void a_full_datagram_does_not_wait(void) {
  struct network network = {0};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 0);
  for (uint64_t at = 0; at < 2 * WIRE_MAX_RANGES + 1; ++at) put_at(&outbox, at);
  CHECK_EQUAL(outbox_send(&outbox, &hal, key, 100, false), 2 * WIRE_MAX_RANGES + OUTBOX_GATHER_US);
  CHECK_EQUAL(network.count, 2);
  CHECK_EQUAL(network.sent[0].count, WIRE_MAX_RANGES);
  CHECK_EQUAL(network.sent[1].count, WIRE_MAX_RANGES);
  CHECK_EQUAL(network.sent[1].range[0].distance_mm, WIRE_MAX_RANGES);
  CHECK_EQUAL(outbox.count, 1);
}

static void a_datagram_is_of_one_epoch(void) {
  struct network network = {0};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 0);
  put_at(&outbox, 10);
  put_at(&outbox, 20);
  struct outbox_range other = range_at(30);
  other.epoch = 78;
  other.time_ns = 123;
  outbox_put(&outbox, &other);
  // No other range of the old epoch will come: it does not wait.
  CHECK_EQUAL(outbox_send(&outbox, &hal, key, 30, false), 30 + OUTBOX_GATHER_US);
  CHECK_EQUAL(network.count, 1);
  CHECK_EQUAL(network.sent[0].count, 2);
  outbox_send(&outbox, &hal, key, 30 + OUTBOX_GATHER_US, false);
  CHECK_EQUAL(network.count, 2);
  CHECK_EQUAL(network.sent[1].epoch, 78);
  CHECK_EQUAL(network.sent[1].time_ns, 123);
  CHECK_EQUAL(network.sent[1].count, 1);
}

static void offsets_are_of_the_first_to_the_nearest_microsecond(void) {
  struct network network = {0};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 0);
  static const int64_t after_ns[] = {0, 499, 500, 1499, 1500, -499, -500, -2600, 10000000000, -10000000000};
  static const int32_t offset_us[] = {0, 0, 1, 1, 2, 0, -1, -3, 10000000, -10000000};
  enum { COUNT = sizeof after_ns / sizeof after_ns[0] };
  for (unsigned i = 0; i < COUNT; ++i) {
    struct outbox_range range = range_at(0);
    range.time_ns = (uint64_t)(20000000000 + after_ns[i]);
    outbox_put(&outbox, &range);
  }
  outbox_send(&outbox, &hal, key, 0, true);
  CHECK_EQUAL(network.count, 1);
  CHECK_EQUAL(network.sent[0].count, COUNT);
  for (unsigned i = 0; i < COUNT; ++i) CHECK_EQUAL(network.sent[0].range[i].offset_us, offset_us[i]);
}

static void what_no_offset_can_say_goes_into_the_next_datagram(void) {
  struct network network = {0};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 0);
  put_at(&outbox, 0);
  struct outbox_range far = range_at(0);
  far.time_ns += 10000001000;
  outbox_put(&outbox, &far);
  CHECK(outbox_send(&outbox, &hal, key, 0, true) == UINT64_MAX);
  CHECK_EQUAL(network.count, 2);
  CHECK_EQUAL(network.sent[1].time_ns, far.time_ns);
}

static void ranges_stay_while_there_is_no_room(void) {
  struct network network = {.down = true};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 0);
  put_at(&outbox, 0);
  CHECK_EQUAL(outbox_send(&outbox, &hal, key, 20000, false), 20000 + OUTBOX_GATHER_US);
  CHECK_EQUAL(network.tried, 1);
  put_at(&outbox, 30000);
  network.down = false;
  outbox_send(&outbox, &hal, key, 40000, false);
  CHECK_EQUAL(network.count, 1);
  CHECK_EQUAL(network.sent[0].count, 2);
  CHECK_EQUAL(network.sent[0].sequence, 0);  // what was not sent took no number
}

static void what_is_too_old_is_dropped_and_told(void) {
  struct network network = {.down = true};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 0);
  put_at(&outbox, 0);
  put_at(&outbox, 1);
  put_at(&outbox, 2);
  outbox_send(&outbox, &hal, key, OUTBOX_TOO_OLD_US, true);
  CHECK_EQUAL(outbox.count, 3);
  network.down = false;
  outbox_send(&outbox, &hal, key, OUTBOX_TOO_OLD_US + 2, true);
  CHECK_EQUAL(network.count, 1);
  CHECK_EQUAL(network.sent[0].count, 1);
  CHECK_EQUAL(network.sent[0].range[0].distance_mm, 2);
  CHECK_EQUAL(network.sent[0].dropped, 2);
}

static void when_full_the_oldest_is_dropped(void) {
  struct network network = {0};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 0);
  for (uint64_t at = 0; at < OUTBOX_ROOM + 5; ++at) put_at(&outbox, at);
  CHECK_EQUAL(outbox.count, OUTBOX_ROOM);
  CHECK(outbox_send(&outbox, &hal, key, 200, true) == UINT64_MAX);
  CHECK_EQUAL(network.count, OUTBOX_ROOM / WIRE_MAX_RANGES);
  int32_t expected = 5;
  for (unsigned i = 0; i < network.count; ++i)
    for (unsigned k = 0; k < network.sent[i].count; ++k)
      CHECK_EQUAL(network.sent[i].range[k].distance_mm, expected++);
  CHECK_EQUAL(expected, OUTBOX_ROOM + 5);
  CHECK_EQUAL(network.sent[0].dropped, 5);
}

static void what_cannot_be_said_does_not_stop_the_rest(void) {
  struct network network = {0};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 0);
  struct outbox_range bad = range_at(0);
  bad.range.peer = 7;
  outbox_put(&outbox, &bad);
  CHECK(outbox_send(&outbox, &hal, key, 0, true) == UINT64_MAX);
  CHECK_EQUAL(network.tried, 0);
  put_at(&outbox, 1);
  outbox_send(&outbox, &hal, key, 1, true);
  CHECK_EQUAL(network.count, 1);
  CHECK_EQUAL(network.sent[0].dropped, 1);
}

static void who_has_nothing_to_tell_greets_once_a_second(void) {
  struct network network = {0};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 3);
  for (uint64_t now = 0; now <= 3 * OUTBOX_GREET_US; now += 1000)
    outbox_greet(&outbox, &hal, key, now, 5, 77);
  CHECK_EQUAL(network.count, 3);
  CHECK_EQUAL(network.sent[0].count, 0);
  CHECK_EQUAL(network.sent[0].epoch, 5);
  CHECK_EQUAL(network.sent[0].time_ns, 77);
  CHECK_EQUAL(network.sent[2].sequence, ((uint64_t)3 << 32) + 2);
}

static void who_tells_ranges_does_not_greet(void) {
  struct network network = {0};
  const struct hal hal = {.board = &network, .send = send};
  struct outbox outbox;
  outbox_start(&outbox, 1, 7, 0);
  for (uint64_t now = 1000; now <= 2 * OUTBOX_GREET_US; now += 200000) {
    put_at(&outbox, now);
    outbox_send(&outbox, &hal, key, now, true);
    outbox_greet(&outbox, &hal, key, now, 5, 77);
  }
  CHECK_EQUAL(network.count, 10);
  for (unsigned i = 0; i < network.count; ++i) CHECK_EQUAL(network.sent[i].count, 1);
}

int main(void) {
  who_has_nothing_to_tell_greets_once_a_second();
  who_tells_ranges_does_not_greet();
  ranges_wait_for_others_and_go_together();
  sequences_rise_with_each_datagram_and_over_restarts();
  a_full_datagram_does_not_wait();
  a_datagram_is_of_one_epoch();
  offsets_are_of_the_first_to_the_nearest_microsecond();
  what_no_offset_can_say_goes_into_the_next_datagram();
  ranges_stay_while_there_is_no_room();
  what_is_too_old_is_dropped_and_told();
  when_full_the_oldest_is_dropped();
  what_cannot_be_said_does_not_stop_the_rest();
  return check_verdict();
}
