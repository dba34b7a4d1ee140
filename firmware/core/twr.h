// Asymmetric double-sided two-way ranging (UM 12.3.2).
#pragma once

#include <stdbool.h>
#include <stdint.h>

// Three frames between two clocks, in ticks: the first and the last go one way, the second the other.
struct twr_stamps {
  uint64_t first_sent, first_received;
  uint64_t second_sent, second_received;
  uint64_t third_sent, third_received;
};

#define TWR_FRACTION 256                      // of a tick
#define TWR_LIGHT_M_PER_S INT64_C(299792458)  // in air 0.03 % less: 3 mm of 10 m

// Time of flight in 1/256 ticks, to the last of them; below 0 where devices touch. False where the stamps
// cannot be of three frames within 0.5 s over at most 1 km between clocks at most 50 ppm apart.
bool twr_time_of_flight(const struct twr_stamps* stamps, int32_t* time_of_flight);

// Micrometres that light goes in a time of flight as above.
int32_t twr_distance_um(int32_t time_of_flight);
