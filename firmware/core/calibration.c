#include "calibration.h"

#include "dw1000.h"
#include "ticks.h"
#include "twr.h"

// By how many mm a range is too long (APS011, PRF 64 MHz, 500 MHz wide), from -61 dBm down in steps of 2 dB.
static const int16_t bias_mm[] = {-110, -105, -100, -93, -82, -69, -51, -27, 0,
                                  21,   35,   42,   49,  62,  71,  76,  81};
static const int strongest_cdbm = -6100;
static const int step_cdb = 200;
static const int steps = sizeof bias_mm / sizeof bias_mm[0] - 1;

// Of one device's range (APS014).
static const int64_t um_per_100_degrees = 215000;

// What light takes for it, to the nearest tick.
static int64_t ticks_of_um(int64_t um) {
  const int64_t um_per_ms = TWR_LIGHT_M_PER_S * 1000;
  const int64_t half = um < 0 ? -um_per_ms / 2 : um_per_ms / 2;
  return (um * (int64_t)TICKS_PER_MS + half) / um_per_ms;
}

// Half of a change of the delay counts in a range: one that is too long asks for twice that.
static uint32_t lengthened(uint32_t antenna_delay, int64_t too_long_um) {
  const int64_t delay = antenna_delay + ticks_of_um(2 * too_long_um);
  return delay < 0 ? 0 : (uint32_t)delay;
}

uint32_t calibration_antenna_delay(const struct calibration* calibration, int16_t temperature_cc) {
  const int warmer_cc = temperature_cc - calibration->temperature_cc;
  return lengthened(calibration->antenna_delay, warmer_cc * um_per_100_degrees / 10000);
}

int32_t calibration_bias_um(uint8_t channel, uint8_t prf_mhz, int16_t rx_power_cdbm) {
  const bool narrow = channel == 1 || channel == 2 || channel == 3 || channel == 5;
  if (!narrow || prf_mhz != 64 || rx_power_cdbm == DW1000_UNKNOWN_POWER) return 0;
  const int below = strongest_cdbm - rx_power_cdbm;
  if (below <= 0) return bias_mm[0] * 1000;
  if (below >= steps * step_cdb) return bias_mm[steps] * 1000;
  const int step = below / step_cdb, into = below % step_cdb;
  return bias_mm[step] * 1000 + (bias_mm[step + 1] - bias_mm[step]) * 1000 * into / step_cdb;
}

uint32_t calibration_corrected_delay(uint32_t antenna_delay, int32_t measured_um, int32_t true_um) {
  return lengthened(antenna_delay, (int64_t)measured_um - true_um);
}

enum calibration_sight calibration_sight(int16_t rx_power_cdbm, int16_t fp_power_cdbm) {
  if (rx_power_cdbm == DW1000_UNKNOWN_POWER || fp_power_cdbm == DW1000_UNKNOWN_POWER) return SIGHT_UNKNOWN;
  const int weaker_cdb = rx_power_cdbm - fp_power_cdbm;
  if (weaker_cdb < 600) return SIGHT_CLEAR;
  return weaker_cdb > 1000 ? SIGHT_BLOCKED : SIGHT_UNKNOWN;
}
