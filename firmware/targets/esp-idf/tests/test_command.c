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

static bool calibrated(char* delay, char* temperature) {
  char* words[] = {"calibrate", delay, temperature};
  return command_read_calibration(COUNT(words), words, &calibration);
}

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
  CHECK(!command_read_calibration(3, words, &calibration));
  words[0] = "calibrate";
  CHECK(!command_read_provision(7, words, &provision));
}

static void a_calibration_is_read_in_ticks_and_degrees(void) {
  CHECK(calibrated("32872", "23.45"));
  CHECK_EQUAL(calibration.antenna_delay, 32872);
  CHECK_EQUAL(calibration.temperature_cc, 2345);
  CHECK(calibrated("0", "-7.5"));
  CHECK_EQUAL(calibration.antenna_delay, 0);
  CHECK_EQUAL(calibration.temperature_cc, -750);
  CHECK(calibrated("0x1FFFE", "85"));
  CHECK_EQUAL(calibration.temperature_cc, 8500);
}

static void calibrations_out_of_range_are_refused(void) {
  CHECK(!calibrated("0x1FFFF", "23"));
  CHECK(!calibrated("-1", "23"));
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
  a_calibration_is_read_in_ticks_and_degrees();
  calibrations_out_of_range_are_refused();
  return check_verdict();
}
