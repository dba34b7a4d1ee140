// From what the radio measures to metres: antenna delay, its temperature, and the bias by power (APS011,
// APS014).
#pragma once

#include <stdint.h>

// What is known of one module; written at the bench, kept in its flash.
struct calibration {
  uint32_t antenna_delay;  // ticks, of sending and receiving together, at
  int16_t temperature_cc;  // 1/100 degrees Celsius
  uint16_t sigma_mm;       // 1 sigma of its ranges to another at rest, in line of sight; 0: unknown
};

// Antenna delay at a temperature: a module's ranges get longer by 2.15 mm per degree (APS014), and a change
// of its delay counts half in each.
uint32_t calibration_antenna_delay(const struct calibration* calibration, int16_t temperature_cc);

// By how much a range measured at this power is too long, in micrometres: subtract it. 0 where the power is
// unknown, and for radio settings that no table is known for (other than PRF 64 MHz on a channel 500 MHz
// wide).
int32_t calibration_bias_um(uint8_t channel, uint8_t prf_mhz, int16_t rx_power_cdbm);

// Distance between two modules of which one has a delay that is off, from measured and true distance (um):
// the delay to set.
uint32_t calibration_corrected_delay(uint32_t antenna_delay, int32_t measured_um, int32_t true_um);

// Hint of non line of sight from received minus first path power (UM 4.7): below 6 dB 0, above 10 dB 1, else
// unknown.
enum calibration_sight { SIGHT_CLEAR = 0, SIGHT_BLOCKED = 1, SIGHT_UNKNOWN = 255 };
enum calibration_sight calibration_sight(int16_t rx_power_cdbm, int16_t fp_power_cdbm);
