#include "twr.h"

#include "ticks.h"

static const int64_t longest_interval = 500 * (int64_t)TICKS_PER_MS;

// 1 km is 213,139.5 ticks.
static const int64_t longest_flight = 213140;

// A module whose antenna delay is still a guess may seem to be up to 10 m behind another.
static const int64_t shortest_flight = -2132;

// 50 ppm are one part in 20,000.
static const int64_t clocks_share = 20000;

static int64_t magnitude(int64_t value) { return value < 0 ? -value : value; }

// value / by to the nearest, halves away from 0; by above 0.
static int64_t divide(int64_t value, int64_t by) { return (2 * value + (value < 0 ? -by : by)) / (2 * by); }

bool twr_time_of_flight(const struct twr_stamps* stamps, int32_t* time_of_flight) {
  const int64_t round_a = (int64_t)ticks_between(stamps->first_sent, stamps->second_received);
  const int64_t reply_a = (int64_t)ticks_between(stamps->second_received, stamps->third_sent);
  const int64_t reply_b = (int64_t)ticks_between(stamps->first_received, stamps->second_sent);
  const int64_t round_b = (int64_t)ticks_between(stamps->second_sent, stamps->third_received);
  if (round_a > longest_interval || reply_a > longest_interval) return false;
  if (round_b > longest_interval || reply_b > longest_interval) return false;

  // From the first frame to the third clocks d apart count the same time, whole_a = (1 + d) whole_b, and d is
  // at most 50 ppm.
  const int64_t whole_a = round_a + reply_a, whole_b = round_b + reply_b;
  if (whole_a == 0 || whole_b == 0) return false;
  if (magnitude(whole_a - whole_b) > whole_b / clocks_share) return false;

  // A round trip is the other's reply and two flights: round_a - reply_b = 2 ToF + d reply_b. With the whole
  // times as equal as they are, round_b - reply_a is then as small.
  if (magnitude(round_a - reply_b) > 2 * longest_flight + reply_b / clocks_share) return false;

  // Intervals are below 2^35, differences now below 2^23, so the sum of the products is below 2^59, and 512
  // times the rest below 2^46.
  const int64_t products = round_a * (round_b - reply_a) + reply_a * (round_a - reply_b);
  const int64_t sum = whole_a + whole_b;
  const int64_t ticks = products / sum, rest = products % sum;
  if (ticks > longest_flight || ticks < shortest_flight) return false;
  *time_of_flight = (int32_t)(ticks * TWR_FRACTION + divide(rest * TWR_FRACTION, sum));
  return true;
}

int32_t twr_distance_um(int32_t time_of_flight) {
  const int64_t um_per_10_us = TWR_LIGHT_M_PER_S * 10;
  const int64_t ticks_per_10_us = (int64_t)TICKS_PER_MS / 100;
  return (int32_t)divide(time_of_flight * um_per_10_us, ticks_per_10_us * TWR_FRACTION);
}
