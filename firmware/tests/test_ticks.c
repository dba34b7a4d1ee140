// The radio's time.
#include "check.h"
#include "ticks.h"

static const uint64_t last = (UINT64_C(1) << 40) - 1;

static void a_millisecond_has_63897600_ticks(void) {
  CHECK_EQUAL(ticks_of_us(1000), 63897600);
  CHECK_EQUAL(ticks_of_us(5), 319488);
  CHECK_EQUAL(ticks_of_us(0), 0);
}

static void microseconds_keep_their_exactness_over_a_day(void) {
  CHECK_EQUAL(ticks_of_us(UINT64_C(86400000000)), INT64_C(5520752640000000));
}

static void a_stamp_wraps_after_17_seconds(void) {
  CHECK_EQUAL(ticks_after(last, 1), 0);
  CHECK_EQUAL(ticks_after(last - 1, 3), 1);
  CHECK_WITHIN(ticks_to_ns(last), INT64_C(17207401000), INT64_C(17207402000));
}

static void time_passes_over_the_wrap(void) {
  CHECK_EQUAL(ticks_between(5, 12), 7);
  CHECK_EQUAL(ticks_between(last, 0), 1);
  CHECK_EQUAL(ticks_between(last - 9, 20), 30);
  CHECK_EQUAL(ticks_between(1, 0), last);
}

static void an_interval_beyond_32_bits_is_kept(void) {
  CHECK_EQUAL(ticks_between(10, ticks_after(10, ticks_of_us(100000))), INT64_C(6389760000));
}

static void what_is_before_is_negative(void) {
  CHECK_EQUAL(ticks_until(20, 25), 5);
  CHECK_EQUAL(ticks_until(25, 20), -5);
  CHECK_EQUAL(ticks_until(last, 4), 5);
  CHECK_EQUAL(ticks_until(4, last), -5);
  CHECK_EQUAL(ticks_until(7, 7), 0);
}

static void half_a_wrap_is_the_farthest(void) {
  CHECK_EQUAL(ticks_until(0, (UINT64_C(1) << 39) - 1), (INT64_C(1) << 39) - 1);
  CHECK_EQUAL(ticks_until(0, UINT64_C(1) << 39), -(INT64_C(1) << 39));
}

static void ticks_become_nanoseconds(void) {
  CHECK_EQUAL(ticks_to_ns(63897600), 1000000);
  CHECK_EQUAL(ticks_to_ns(64), 1);
  CHECK_EQUAL(ticks_to_ns(63), 0);
}

int main(void) {
  a_millisecond_has_63897600_ticks();
  microseconds_keep_their_exactness_over_a_day();
  a_stamp_wraps_after_17_seconds();
  time_passes_over_the_wrap();
  an_interval_beyond_32_bits_is_kept();
  what_is_before_is_negative();
  half_a_wrap_is_the_farthest();
  ticks_become_nanoseconds();
  return check_verdict();
}
