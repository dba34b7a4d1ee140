// Antenna delay, temperature, bias by power, sight.
#include "calibration.h"
#include "check.h"
#include "twr.h"

#define NO_POWER INT16_MIN

// APS011: 0 at -77 dBm, ranges too short when stronger, too long when weaker.
static void bias_is_that_of_the_table(void) {
  CHECK_EQUAL(calibration_bias_um(5, 64, -7700), 0);
  CHECK_EQUAL(calibration_bias_um(5, 64, -6100), -110000);
  CHECK_EQUAL(calibration_bias_um(5, 64, -6900), -82000);
  CHECK_EQUAL(calibration_bias_um(5, 64, -7500), -27000);
  CHECK_EQUAL(calibration_bias_um(5, 64, -7900), 21000);
  CHECK_EQUAL(calibration_bias_um(5, 64, -8500), 49000);
  CHECK_EQUAL(calibration_bias_um(5, 64, -9300), 81000);
}

static void bias_is_linear_between(void) {
  CHECK_EQUAL(calibration_bias_um(5, 64, -7800), 10500);
  CHECK_EQUAL(calibration_bias_um(5, 64, -7600), -13500);
  CHECK_EQUAL(calibration_bias_um(5, 64, -6101), -109975);
  CHECK_EQUAL(calibration_bias_um(5, 64, -9299), 80975);
}

static void bias_ends_where_the_table_does(void) {
  CHECK_EQUAL(calibration_bias_um(5, 64, -6000), -110000);
  CHECK_EQUAL(calibration_bias_um(5, 64, INT16_MAX), -110000);
  CHECK_EQUAL(calibration_bias_um(5, 64, -9400), 81000);
  CHECK_EQUAL(calibration_bias_um(5, 64, INT16_MIN + 1), 81000);
}

static void bias_never_falls_as_the_signal_weakens(void) {
  int32_t before = -110000;
  for (int power = -6000; power >= -9500; --power) {
    const int32_t bias = calibration_bias_um(5, 64, (int16_t)power);
    CHECK_WITHIN(bias, before, before + 150);
    before = bias;
  }
}

static void bias_is_known_for_500_mhz_at_prf_64_alone(void) {
  for (int channel = 0; channel < 16; ++channel) {
    const int narrow = channel == 1 || channel == 2 || channel == 3 || channel == 5;
    CHECK_EQUAL(calibration_bias_um((uint8_t)channel, 64, -9300), narrow ? 81000 : 0);
    CHECK_EQUAL(calibration_bias_um((uint8_t)channel, 16, -9300), 0);
  }
  CHECK_EQUAL(calibration_bias_um(5, 64, NO_POWER), 0);
}

// 2.15 mm of range a degree are 4.30 mm of delay, and a tick is 4.6918 mm.
static void a_warm_module_has_a_longer_delay(void) {
  const struct calibration bench = {.antenna_delay = 32872, .temperature_cc = 2300};
  CHECK_EQUAL(calibration_antenna_delay(&bench, 2300), 32872);
  CHECK_EQUAL(calibration_antenna_delay(&bench, 3300), 32881);  // + 9.17
  CHECK_EQUAL(calibration_antenna_delay(&bench, 1300), 32863);
  CHECK_EQUAL(calibration_antenna_delay(&bench, 8500), 32929);   // + 56.82
  CHECK_EQUAL(calibration_antenna_delay(&bench, -4000), 32814);  // - 57.74
}

static void a_range_that_is_too_long_asks_for_a_longer_delay(void) {
  CHECK_EQUAL(calibration_corrected_delay(32872, 7000000, 7000000), 32872);
  CHECK_EQUAL(calibration_corrected_delay(32872, 7234588, 7000000), 32972);
  CHECK_EQUAL(calibration_corrected_delay(32872, 6765412, 7000000), 32772);
  // 77 m too long: a radio whose delay is set to 0.
  CHECK_EQUAL(calibration_corrected_delay(0, 84113834, 7000000), 32872);
}

static void a_corrected_delay_mends_the_range(void) {
  for (int32_t off = -400; off <= 400; ++off) {
    const int32_t distance = 10000000;
    const int32_t measured = distance + twr_distance_um(off * TWR_FRACTION / 2);
    CHECK_EQUAL(calibration_corrected_delay(32000, measured, distance), 32000 + off);
  }
}

static void no_delay_is_below_zero(void) {
  const struct calibration bench = {.antenna_delay = 5, .temperature_cc = 8500};
  CHECK_EQUAL(calibration_antenna_delay(&bench, -4000), 0);
  CHECK_EQUAL(calibration_corrected_delay(5, INT32_MIN, INT32_MAX), 0);
}

static void a_weak_first_path_hints_at_a_wall(void) {
  CHECK_EQUAL(calibration_sight(-8000, -8000), SIGHT_CLEAR);
  CHECK_EQUAL(calibration_sight(-8000, -8599), SIGHT_CLEAR);
  CHECK_EQUAL(calibration_sight(-8000, -8600), SIGHT_UNKNOWN);
  CHECK_EQUAL(calibration_sight(-8000, -9000), SIGHT_UNKNOWN);
  CHECK_EQUAL(calibration_sight(-8000, -9001), SIGHT_BLOCKED);
  CHECK_EQUAL(calibration_sight(-8000, -7000), SIGHT_CLEAR);
  CHECK_EQUAL(calibration_sight(INT16_MAX, INT16_MIN + 1), SIGHT_BLOCKED);
}

static void no_power_gives_no_hint(void) {
  CHECK_EQUAL(calibration_sight(NO_POWER, -8000), SIGHT_UNKNOWN);
  CHECK_EQUAL(calibration_sight(-8000, NO_POWER), SIGHT_UNKNOWN);
}

int main(void) {
  bias_is_that_of_the_table();
  bias_is_linear_between();
  bias_ends_where_the_table_does();
  bias_never_falls_as_the_signal_weakens();
  bias_is_known_for_500_mhz_at_prf_64_alone();
  a_warm_module_has_a_longer_delay();
  a_range_that_is_too_long_asks_for_a_longer_delay();
  a_corrected_delay_mends_the_range();
  no_delay_is_below_zero();
  a_weak_first_path_hints_at_a_wall();
  no_power_gives_no_hint();
  return check_verdict();
}
