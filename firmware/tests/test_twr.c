// Time of flight from three frames' stamps.
#include "check.h"
#include "ticks.h"
#include "twr.h"

#define MS ((int64_t)TICKS_PER_MS)

// A first frames and third, B the second; round and reply are each one's own ticks.
struct intervals {
  int64_t round_a, reply_a, reply_b, round_b;
};

static struct twr_stamps stamps_of(uint64_t clock_a, uint64_t clock_b, const struct intervals* of) {
  struct twr_stamps stamps = {.first_sent = clock_a & TICKS_MASK, .first_received = clock_b & TICKS_MASK};
  stamps.second_sent = ticks_after(stamps.first_received, (uint64_t)of->reply_b);
  stamps.second_received = ticks_after(stamps.first_sent, (uint64_t)of->round_a);
  stamps.third_sent = ticks_after(stamps.second_received, (uint64_t)of->reply_a);
  stamps.third_received = ticks_after(stamps.second_sent, (uint64_t)of->round_b);
  return stamps;
}

// INT32_MIN where refused.
static int32_t flight_of(int64_t round_a, int64_t reply_a, int64_t reply_b, int64_t round_b) {
  const struct intervals intervals = {round_a, reply_a, reply_b, round_b};
  const struct twr_stamps stamps = stamps_of(UINT64_C(0xA987654321), UINT64_C(0x123456789A), &intervals);
  int32_t time_of_flight = 0;
  return twr_time_of_flight(&stamps, &time_of_flight) ? time_of_flight : INT32_MIN;
}

// (Ra Rb - Da Db) / (Ra + Rb + Da + Db) x 256 in exact fractions, elsewhere computed.
static void results_are_exact_to_the_last_fraction(void) {
  static const struct {
    struct intervals of;
    int32_t expected;
  } known[] = {
      {{31886496665, 31886496645, 31884902400, 31884902420}, 2560},      // 2560.0
      {{31883737322, 12778882302, 31884902400, 12779946000}, 54526631},  // 54526630.97
      {{63942786, 63900156, 63897600, 63940228}, 5456512},               // 5456511.997
      {{63895004, 19168513229, 63897600, 19169279960}, -5132},           // -5132.43
      {{19170048772, 63900156, 19169280000, 63899600}, 255993},          // 255993.18
      {{638984371, 447289015, 638976000, 447283264}, 8184},              // 8184.48
      {{123463296, 987637235, 123456789, 987662961}, 1106240},           // 1106240.33
  };
  for (unsigned i = 0; i < sizeof known / sizeof known[0]; ++i) {
    const struct intervals* of = &known[i].of;
    CHECK_EQUAL(flight_of(of->round_a, of->reply_a, of->reply_b, of->round_b), known[i].expected);
  }
}

static void equal_clocks_give_half_of_the_difference(void) {
  CHECK_EQUAL(flight_of(1000200, 1000000, 1000000, 1000200), 100 * TWR_FRACTION);
  CHECK_EQUAL(flight_of(MS, MS, MS, MS), 0);
}

static void where_devices_touch_time_may_be_below_zero(void) {
  CHECK_EQUAL(flight_of(MS, MS + 40, MS + 40, MS), -20 * TWR_FRACTION);
}

static void halves_are_rounded_away_from_zero(void) {
  CHECK_EQUAL(flight_of(25750, 25449, 25650, 25551), 12929);   // 12928.5
  CHECK_EQUAL(flight_of(25449, 25750, 25551, 25650), -12929);  // -12928.5
}

static void every_stamp_may_be_beyond_the_wrap(void) {
  const struct intervals intervals = {2 * MS + 426, 3 * MS, 2 * MS, 3 * MS + 426};
  const uint64_t before_wrap[] = {
      0, 1, (uint64_t)MS, 2 * (uint64_t)MS + 1, 4 * (uint64_t)MS, 6 * (uint64_t)MS};
  for (unsigned a = 0; a < sizeof before_wrap / sizeof before_wrap[0]; ++a) {
    for (unsigned b = 0; b < sizeof before_wrap / sizeof before_wrap[0]; ++b) {
      const struct twr_stamps stamps = stamps_of(0 - before_wrap[a], 0 - before_wrap[b], &intervals);
      int32_t time_of_flight = 0;
      CHECK(twr_time_of_flight(&stamps, &time_of_flight));
      CHECK_EQUAL(time_of_flight, 213 * TWR_FRACTION);
    }
  }
}

// UM 12.3.2: 2.2 mm at 100 m with both clocks 20 ppm off, however unequal the replies.
static void clocks_off_by_20_ppm_cost_millimetres(void) {
  static const int32_t ppm[] = {-20, 0, 20};
  static const int64_t reply_ms[][2] = {{1, 1}, {1, 9}, {9, 1}, {40, 3}, {450, 450}};
  const int64_t flight = 21314;  // ticks, 100.0003 m
  for (unsigned i = 0; i < 9; ++i) {
    const int64_t a = 1000000 + ppm[i % 3], b = 1000000 + ppm[i / 3];
    for (unsigned j = 0; j < sizeof reply_ms / sizeof reply_ms[0]; ++j) {
      const int64_t reply_a = reply_ms[j][0] * MS, reply_b = reply_ms[j][1] * MS;
      const int32_t found = flight_of((reply_b + 2 * flight) * a / 1000000, reply_a * a / 1000000,
                                      reply_b * b / 1000000, (reply_a + 2 * flight) * b / 1000000);
      // The clocks' 20 ppm of 100 m, and up to a tick by what was cut off of four intervals.
      CHECK_WITHIN(found, (flight - 1) * TWR_FRACTION - 110, (flight + 1) * TWR_FRACTION + 110);
      CHECK_WITHIN(twr_distance_um(found), 99995000, 100005500);
    }
  }
}

static void intervals_beyond_half_a_second_are_refused(void) {
  CHECK_EQUAL(flight_of(500 * MS, 500 * MS, 500 * MS, 500 * MS), 0);
  CHECK_EQUAL(flight_of(500 * MS + 1, 500 * MS, 500 * MS, 500 * MS), INT32_MIN);
  CHECK_EQUAL(flight_of(500 * MS, 500 * MS + 1, 500 * MS, 500 * MS), INT32_MIN);
  CHECK_EQUAL(flight_of(500 * MS, 500 * MS, 500 * MS + 1, 500 * MS), INT32_MIN);
  CHECK_EQUAL(flight_of(500 * MS, 500 * MS, 500 * MS, 500 * MS + 1), INT32_MIN);
}

static void flights_beyond_a_kilometre_are_refused(void) {
  CHECK_EQUAL(flight_of(MS + 426280, MS, MS, MS + 426280), 213140 * TWR_FRACTION);
  CHECK_EQUAL(flight_of(MS + 426282, MS, MS, MS + 426282), INT32_MIN);
}

static void flights_far_below_zero_are_refused(void) {
  CHECK_EQUAL(flight_of(MS, MS + 4264, MS + 4264, MS), -2132 * TWR_FRACTION);
  CHECK_EQUAL(flight_of(MS, MS + 4266, MS + 4266, MS), INT32_MIN);
}

// 2 ms by B's clock: 50 ppm are 6389 ticks. Both of A's intervals take their half.
static void clocks_more_than_50_ppm_apart_are_refused(void) {
  CHECK(flight_of(MS + 3194, MS + 3194, MS, MS) != INT32_MIN);
  CHECK(flight_of(MS - 3194, MS - 3194, MS, MS) != INT32_MIN);
  CHECK_EQUAL(flight_of(MS + 3195, MS + 3195, MS, MS), INT32_MIN);
  CHECK_EQUAL(flight_of(MS - 3195, MS - 3195, MS, MS), INT32_MIN);
}

// A stamp that is wrong by 150 ns, as after a receiver that was not reset, makes the two clocks disagree.
static void one_wrong_stamp_is_refused(void) {
  const struct intervals intervals = {2 * MS + 426, 3 * MS, 2 * MS, 3 * MS + 426};
  const struct twr_stamps right = stamps_of(77, 88, &intervals);
  int32_t time_of_flight = 0;
  CHECK(twr_time_of_flight(&right, &time_of_flight));
  struct twr_stamps wrong = right;
  wrong.first_received = ticks_after(right.first_received, 20000);
  CHECK(!twr_time_of_flight(&wrong, &time_of_flight));
  wrong = right;
  wrong.third_received = ticks_after(right.third_received, 20000);
  CHECK(!twr_time_of_flight(&wrong, &time_of_flight));
}

static void stamps_of_another_beginning_of_a_clock_are_refused(void) {
  const struct intervals intervals = {2 * MS + 426, 3 * MS, 2 * MS, 3 * MS + 426};
  const struct twr_stamps right = stamps_of(1000 * (uint64_t)MS, 88, &intervals);
  int32_t time_of_flight = 0;
  struct twr_stamps anew = right;  // A began anew between its two frames
  anew.second_received = 5 * (uint64_t)MS;
  anew.third_sent = 8 * (uint64_t)MS;
  CHECK(!twr_time_of_flight(&anew, &time_of_flight));
  anew = right;
  anew.third_sent = 8 * (uint64_t)MS;
  CHECK(!twr_time_of_flight(&anew, &time_of_flight));
}

// Without replies a round trip would be all flight. Its square is a multiple of 2^64: nothing, to a product
// of 64 bits.
static void a_round_trip_much_longer_than_the_reply_is_refused(void) {
  const int64_t round = INT64_C(1) << 34;
  CHECK_EQUAL(flight_of(round, 0, 0, round), INT32_MIN);
  CHECK_EQUAL(flight_of(0, round, round, 0), INT32_MIN);
}

static void frames_at_one_moment_are_refused(void) { CHECK_EQUAL(flight_of(0, 0, 0, 0), INT32_MIN); }

static void light_goes_30_cm_in_a_nanosecond(void) {
  CHECK_EQUAL(twr_distance_um(TWR_FRACTION), 4692);
  CHECK_EQUAL(twr_distance_um(-TWR_FRACTION), -4692);
  CHECK_EQUAL(twr_distance_um(1), 18);
  CHECK_EQUAL(twr_distance_um(0), 0);
  CHECK_EQUAL(twr_distance_um(100 * TWR_FRACTION), 469176);
  CHECK_EQUAL(twr_distance_um(213140 * TWR_FRACTION), 1000002574);
  CHECK_EQUAL(twr_distance_um(-2132 * TWR_FRACTION), -10002841);
}

#ifdef __SIZEOF_INT128__
__extension__ typedef __int128 wide;

static uint64_t random_below(uint64_t* state, uint64_t limit) {
  *state = *state * UINT64_C(6364136223846793005) + 1442695040888963407;
  return (*state >> 20) % limit;
}

static int64_t exact(const struct intervals* of) {
  const wide sum = (wide)of->round_a + of->reply_a + of->reply_b + of->round_b;
  const wide scaled = ((wide)of->round_a * of->round_b - (wide)of->reply_a * of->reply_b) * TWR_FRACTION;
  return (int64_t)((2 * scaled + (scaled < 0 ? -sum : sum)) / (2 * sum));
}

// Whatever is accepted is exact; and all that three frames can be is accepted.
static void every_result_is_that_of_128_bit_arithmetic(void) {
  uint64_t state = 1;
  for (unsigned i = 0; i < 200000; ++i) {
    const int64_t longest = random_below(&state, 2) != 0 ? 499 * MS : MS;
    const int64_t flight = (int64_t)random_below(&state, 213000) - 2000;
    const int64_t ppb = (int64_t)random_below(&state, 92000) - 46000;
    const int64_t reply_a = 10 * MS / 100 + 5000 + (int64_t)random_below(&state, (uint64_t)longest);
    const int64_t reply_b = 10 * MS / 100 + 5000 + (int64_t)random_below(&state, (uint64_t)longest);
    const int64_t round_a = reply_b + 2 * flight;
    const struct intervals of = {
        round_a + round_a / 1000 * ppb / 1000000 + (int64_t)random_below(&state, 20),
        reply_a + reply_a / 1000 * ppb / 1000000 + (int64_t)random_below(&state, 20),
        reply_b,
        reply_a + 2 * flight,
    };
    CHECK_EQUAL(flight_of(of.round_a, of.reply_a, of.reply_b, of.round_b), exact(&of));
  }
}
#endif

int main(void) {
  results_are_exact_to_the_last_fraction();
  equal_clocks_give_half_of_the_difference();
  where_devices_touch_time_may_be_below_zero();
  halves_are_rounded_away_from_zero();
  every_stamp_may_be_beyond_the_wrap();
  clocks_off_by_20_ppm_cost_millimetres();
  intervals_beyond_half_a_second_are_refused();
  flights_beyond_a_kilometre_are_refused();
  flights_far_below_zero_are_refused();
  clocks_more_than_50_ppm_apart_are_refused();
  one_wrong_stamp_is_refused();
  stamps_of_another_beginning_of_a_clock_are_refused();
  a_round_trip_much_longer_than_the_reply_is_refused();
  frames_at_one_moment_are_refused();
  light_goes_30_cm_in_a_nanosecond();
#ifdef __SIZEOF_INT128__
  every_result_is_that_of_128_bit_arithmetic();
#endif
  return check_verdict();
}
