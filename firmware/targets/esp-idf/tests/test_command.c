#include <string.h>

#include "command.h"
#include "firmware/tests/check.h"

#define KEY "000102030405060708090a0b0c0d0e0f101112131415161718191A1B1C1D1E1F"
#define COUNT(words) (sizeof(words) / sizeof(words)[0])

static struct store_provision provision;
static struct calibration calibration;

static bool provisioned(char* session, char* address, char* key, char* ssid, char* password,
                        char* collector) {
  char* words[] = {"provision", session, address, key, ssid, password, collector};
  return command_read_provision(COUNT(words), words, &provision);
}

static bool calibrated_with(char* delay, char* temperature, char* sigma) {
  char* words[] = {"calibrate", delay, temperature, sigma};
  return command_read_calibration(COUNT(words), words, &calibration);
}

static bool calibrated(char* delay, char* temperature) { return calibrated_with(delay, temperature, "20"); }

static void what_is_provisioned_is_read(void) {
  CHECK(provisioned("0xFFFFFFFF", "65533", KEY, "a net", "password", "192.168.1.10"));
  CHECK_EQUAL(provision.session, 0xFFFFFFFF);
  CHECK_EQUAL(provision.address, 65533);
  for (int i = 0; i < WIRE_KEY_SIZE; ++i) CHECK_EQUAL(provision.key[i], i);
  CHECK(strcmp(provision.ssid, "a net") == 0);
  CHECK(strcmp(provision.password, "password") == 0);
  CHECK(strcmp(provision.collector, "192.168.1.10") == 0);
}

static void numbers_out_of_range_are_refused(void) {
  CHECK(!provisioned("0x100000000", "1", KEY, "net", "password", "10.0.0.1"));
  CHECK(!provisioned("-1", "1", KEY, "net", "password", "10.0.0.1"));
  CHECK(!provisioned("", "1", KEY, "net", "password", "10.0.0.1"));
  CHECK(!provisioned("1x", "1", KEY, "net", "password", "10.0.0.1"));
  CHECK(!provisioned("99999999999999999999999999", "1", KEY, "net", "password", "10.0.0.1"));
  CHECK(!provisioned("1", "65534", KEY, "net", "password", "10.0.0.1"));
  CHECK(!provisioned("1", " 1", KEY, "net", "password", "10.0.0.1"));
}

static void a_key_has_64_digits(void) {
  char key[] = KEY "0";
  CHECK(!provisioned("1", "1", key, "net", "password", "10.0.0.1"));
  key[63] = '\0';
  CHECK(!provisioned("1", "1", key, "net", "password", "10.0.0.1"));
  char other[] = KEY;
  other[40] = 'g';
  CHECK(!provisioned("1", "1", other, "net", "password", "10.0.0.1"));
}

static void names_that_do_not_fit_are_refused(void) {
  char ssid[34], password[65];
  memset(ssid, 's', sizeof ssid);
  memset(password, 'p', sizeof password);
  ssid[32] = password[63] = '\0';
  CHECK(provisioned("1", "1", KEY, ssid, password, "255.255.255.255"));
  CHECK_EQUAL(strlen(provision.ssid), 32);
  CHECK_EQUAL(strlen(provision.password), 63);
  ssid[32] = 's', ssid[33] = '\0';
  CHECK(!provisioned("1", "1", KEY, ssid, password, "10.0.0.1"));
  password[63] = 'p', password[64] = '\0';
  CHECK(!provisioned("1", "1", KEY, "net", password, "10.0.0.1"));
  CHECK(!provisioned("1", "1", KEY, "", "password", "10.0.0.1"));
}

static void a_network_is_open_or_has_a_password_of_eight(void) {
  CHECK(provisioned("1", "1", KEY, "net", "", "10.0.0.1"));
  CHECK(provisioned("1", "1", KEY, "net", "12345678", "10.0.0.1"));
  CHECK(!provisioned("1", "1", KEY, "net", "1234567", "10.0.0.1"));
}

static void a_collector_is_an_address_in_decimals(void) {
  CHECK(!provisioned("1", "1", KEY, "net", "password", "collector.local"));
  CHECK(!provisioned("1", "1", KEY, "net", "password", "10.0.0.256"));
  CHECK(!provisioned("1", "1", KEY, "net", "password", "10.0.0"));
  CHECK(!provisioned("1", "1", KEY, "net", "password", ""));
}

static void words_too_few_or_too_many_or_of_another_command_are_refused(void) {
  char* words[] = {"provision", "1", "1", KEY, "net", "password", "10.0.0.1", "more"};
  CHECK(command_read_provision(7, words, &provision));
  CHECK(!command_read_provision(6, words, &provision));
  CHECK(!command_read_provision(8, words, &provision));
  CHECK(!command_read_provision(0, words, &provision));
  CHECK(!command_read_calibration(4, words, &calibration));
  char* calibrate[] = {"calibrate", "32872", "23", "20", "more"};
  CHECK(command_read_calibration(4, calibrate, &calibration));
  CHECK(!command_read_calibration(3, calibrate, &calibration));
  CHECK(!command_read_calibration(5, calibrate, &calibration));
  words[0] = "calibrate";
  CHECK(!command_read_provision(7, words, &provision));
}

static void a_calibration_is_read_in_ticks_degrees_and_millimetres(void) {
  CHECK(calibrated_with("32872", "23", "0"));
  CHECK_EQUAL(calibration.sigma_mm, 0);
  CHECK(calibrated_with("32872", "23", "1000"));
  CHECK_EQUAL(calibration.sigma_mm, 1000);
  CHECK(calibrated("32872", "23.45"));
  CHECK_EQUAL(calibration.antenna_delay, 32872);
  CHECK_EQUAL(calibration.temperature_cc, 2345);
  CHECK(calibrated("0", "-7.5"));
  CHECK_EQUAL(calibration.antenna_delay, 0);
  CHECK_EQUAL(calibration.temperature_cc, -750);
  CHECK(calibrated("0x1FFFE", "85"));
  CHECK_EQUAL(calibration.temperature_cc, 8500);
}

static bool corrected(char* measured, char* true_distance) {
  char* words[] = {"correct", measured, true_distance};
  calibration = (struct calibration){.antenna_delay = 32872, .temperature_cc = 2345, .sigma_mm = 20};
  return command_correct_calibration(COUNT(words), words, &calibration);
}

// A tick of 15.65 ps is 4.69 mm, and the delay counts half: 100 mm are 42.6 ticks of it.
static void a_correction_makes_up_for_what_was_measured_too_long_or_too_short(void) {
  CHECK(corrected("5100", "5000"));
  CHECK_EQUAL(calibration.antenna_delay, 32872 + 43);
  CHECK(corrected("4900", "5000"));
  CHECK_EQUAL(calibration.antenna_delay, 32872 - 43);
  CHECK(corrected("5000", "5000"));
  CHECK_EQUAL(calibration.antenna_delay, 32872);
  CHECK(corrected("154000", "0"));
  CHECK_WITHIN(calibration.antenna_delay, 32872 + 65600, 32872 + 65700);
}

static void a_correction_leaves_temperature_and_sigma(void) {
  CHECK(corrected("5100", "5000"));
  CHECK_EQUAL(calibration.temperature_cc, 2345);
  CHECK_EQUAL(calibration.sigma_mm, 20);
}

static void corrections_that_cannot_be_are_refused_and_change_nothing(void) {
  CHECK(!corrected("5.1", "5"));  // in metres
  CHECK(!corrected("-100", "5000"));
  CHECK(!corrected("5100", ""));
  CHECK(!corrected("1000001", "1000000"));
  CHECK(!corrected("5", "100000"));   // a delay below 0
  CHECK(!corrected("1000000", "5"));  // one of more than the registers hold
  CHECK_EQUAL(calibration.antenna_delay, 32872);
  char* words[] = {"correct", "5100", "5000", "more"};
  CHECK(!command_correct_calibration(2, words, &calibration));
  CHECK(!command_correct_calibration(4, words, &calibration));
  words[0] = "calibrate";
  CHECK(!command_correct_calibration(3, words, &calibration));
  CHECK_EQUAL(calibration.antenna_delay, 32872);
}

static void calibrations_out_of_range_are_refused(void) {
  CHECK(!calibrated("0x1FFFF", "23"));
  CHECK(!calibrated("-1", "23"));
  CHECK(!calibrated_with("32872", "23", "1001"));
  CHECK(!calibrated_with("32872", "23", "2 cm"));
  CHECK(!calibrated_with("32872", "23", "-1"));
  CHECK(!calibrated_with("32872", "23", ""));
  CHECK(!calibrated("32872", "85.1"));
  CHECK(!calibrated("32872", "-40.1"));
  CHECK(!calibrated("32872", "nan"));
  CHECK(!calibrated("32872", "warm"));
  CHECK(!calibrated("32872", "23 C"));
  CHECK(!calibrated("32872", ""));
}

int main(void) {
  what_is_provisioned_is_read();
  numbers_out_of_range_are_refused();
  a_key_has_64_digits();
  names_that_do_not_fit_are_refused();
  a_network_is_open_or_has_a_password_of_eight();
  a_collector_is_an_address_in_decimals();
  words_too_few_or_too_many_or_of_another_command_are_refused();
  a_calibration_is_read_in_ticks_degrees_and_millimetres();
  calibrations_out_of_range_are_refused();
  a_correction_makes_up_for_what_was_measured_too_long_or_too_short();
  a_correction_leaves_temperature_and_sigma();
  corrections_that_cannot_be_are_refused_and_change_nothing();
  return check_verdict();
}
