// Who sends when, and how often.
#include <stdbool.h>

#include "check.h"
#include "timetable.h"

// Rounds a second to the nearest, `tenths` true: in tenths.
static unsigned rate(uint8_t scheme, unsigned members, bool tenths) {
  const uint32_t round_us = timetable_round_us(scheme, members);
  return ((tenths ? 10000000 : 1000000) + round_us / 2) / round_us;
}

// 1000 / (80 + 21 n), 1000 / (n + 2) and 1000 / (n + 1).
static void rates_are_those_of_the_table(void) {
  static const struct {
    unsigned members, polling_tenths, one_to_n, all_pairs;
  } table[] = {{1, 99, 333, 500}, {2, 82, 250, 333}, {3, 70, 200, 250}, {5, 54, 143, 167}, {10, 34, 83, 91}};
  for (unsigned i = 0; i < sizeof table / sizeof table[0]; ++i) {
    CHECK_EQUAL(rate(SCHEME_POLLING, table[i].members, true), table[i].polling_tenths);
    CHECK_EQUAL(rate(SCHEME_ONE_TO_N, table[i].members, false), table[i].one_to_n);
    CHECK_EQUAL(rate(SCHEME_ALL_PAIRS, table[i].members, false), table[i].all_pairs);
  }
}

static void the_default_is_at_least_twenty_times_polling_for_two(void) {
  CHECK(timetable_round_us(SCHEME_POLLING, 2) >= 20 * timetable_round_us(SCHEME_ONE_TO_N, 2));
}

static void check_slots(uint8_t scheme, unsigned members, const int senders[], const int addressees[],
                        unsigned slots) {
  CHECK_EQUAL(timetable_slots(scheme, members), slots);
  for (unsigned slot = 0; slot < slots; ++slot) {
    CHECK_EQUAL(timetable_sender(scheme, members, slot), senders[slot]);
    CHECK_EQUAL(timetable_addressee(scheme, members, slot), addressees[slot]);
  }
  CHECK_EQUAL(timetable_sender(scheme, members, slots), TIMETABLE_NOBODY);
  CHECK_EQUAL(timetable_addressee(scheme, members, slots), TIMETABLE_NOBODY);
  CHECK_EQUAL(timetable_sender(scheme, members, UINT32_MAX), TIMETABLE_NOBODY);
}

static void one_to_n_is_a_poll_the_answers_and_a_final(void) {
  const int senders[] = {0, 1, 2, 3, 0};
  const int addressees[] = {TIMETABLE_NOBODY, 0, 0, 0, TIMETABLE_NOBODY};
  check_slots(SCHEME_ONE_TO_N, 3, senders, addressees, 5);
}

static void in_all_pairs_everybody_speaks_once_to_everybody(void) {
  const int senders[] = {0, 1, 2, 3};
  const int addressees[] = {TIMETABLE_NOBODY, TIMETABLE_NOBODY, TIMETABLE_NOBODY, TIMETABLE_NOBODY};
  check_slots(SCHEME_ALL_PAIRS, 3, senders, addressees, 4);
}

static void polling_takes_one_after_the_other(void) {
  const int senders[] = {0, 1, 0, 0, 2, 0};
  const int addressees[] = {1, 0, 1, 2, 0, 2};
  check_slots(SCHEME_POLLING, 2, senders, addressees, 6);
  CHECK_EQUAL(timetable_slot_us(SCHEME_POLLING), 7000);
}

static void a_coordinator_alone_speaks_seldom(void) {
  const int senders[] = {0}, addressees[] = {TIMETABLE_NOBODY};
  for (unsigned i = 0; i < SCHEMES; ++i) {
    const uint8_t scheme = (uint8_t)i;
    check_slots(scheme, 0, senders, addressees, 1);
    CHECK(timetable_round_us(scheme, 0) >= 10000);
  }
}

// What ranging builds on: all slots lie within the round, the coordinator begins, all members speak and
// nobody else.
static void every_scheme_and_size_is_sound(void) {
  for (unsigned i = 0; i < SCHEMES; ++i) {
    const uint8_t scheme = (uint8_t)i;
    for (unsigned members = 0; members <= 10; ++members) {
      const unsigned slots = timetable_slots(scheme, members);
      CHECK(slots * timetable_slot_us(scheme) <= timetable_round_us(scheme, members));
      CHECK_EQUAL(timetable_sender(scheme, members, 0), 0);
      unsigned spoke = 0;
      for (unsigned slot = 0; slot < slots; ++slot) {
        const int sender = timetable_sender(scheme, members, slot);
        const int addressee = timetable_addressee(scheme, members, slot);
        CHECK_WITHIN(sender, 0, members);
        CHECK_WITHIN(addressee, TIMETABLE_NOBODY, members);
        CHECK(sender != addressee);
        if (sender >= 0) spoke |= 1U << sender;
      }
      CHECK_EQUAL(spoke, (2U << members) - 1);
    }
  }
}

int main(void) {
  rates_are_those_of_the_table();
  the_default_is_at_least_twenty_times_polling_for_two();
  one_to_n_is_a_poll_the_answers_and_a_final();
  in_all_pairs_everybody_speaks_once_to_everybody();
  polling_takes_one_after_the_other();
  a_coordinator_alone_speaks_seldom();
  every_scheme_and_size_is_sound();
  return check_verdict();
}
