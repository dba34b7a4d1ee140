#include "command.h"

#include <arpa/inet.h>
#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "wire.h"

#define HIGHEST_DELAY 0x1FFFE  // two registers of 16 bits
#define HIGHEST_SIGMA_MM 1000
#define FARTHEST_MM 1000000  // in um still an int32_t
#define SHORTEST_PASSWORD 8  // WPA2; an empty one is for open networks
#define LEAST_C (-40.0)      // what the radio is made for
#define MOST_C 85.0

static bool read_number(const char* word, unsigned long most, unsigned long* number) {
  if (!isdigit((unsigned char)word[0])) return false;  // strtoul would take a sign, and blanks
  char* end = NULL;
  errno = 0;
  *number = strtoul(word, &end, 0);
  return errno == 0 && *end == '\0' && *number <= most;
}

static int digit_of(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

static bool read_key(const char* word, uint8_t key[WIRE_KEY_SIZE]) {
  if (strlen(word) != (size_t)2 * WIRE_KEY_SIZE) return false;
  for (size_t i = 0; i < WIRE_KEY_SIZE; ++i) {
    const int high = digit_of(word[2 * i]), low = digit_of(word[2 * i + 1]);
    if (high < 0 || low < 0) return false;
    key[i] = (uint8_t)(high * 16 + low);
  }
  return true;
}

static bool copy_word(const char* word, size_t least, char* text, size_t room) {
  const size_t size = strlen(word);
  if (size < least || size >= room) return false;
  memcpy(text, word, size + 1);
  return true;
}

bool command_read_provision(size_t count, char* const* words, struct store_provision* provision) {
  if (count != 7 || strcmp(words[0], "provision") != 0) return false;
  memset(provision, 0, sizeof *provision);
  unsigned long session = 0, address = 0;
  struct in_addr collector;
  if (!read_number(words[1], UINT32_MAX, &session) || !read_number(words[2], WIRE_LAST_ADDRESS, &address))
    return false;
  provision->session = (uint32_t)session;
  provision->address = (uint16_t)address;
  const size_t least = words[5][0] == '\0' ? 0 : SHORTEST_PASSWORD;
  return read_key(words[3], provision->key) &&
         copy_word(words[4], 1, provision->ssid, sizeof provision->ssid) &&
         copy_word(words[5], least, provision->password, sizeof provision->password) &&
         inet_pton(AF_INET, words[6], &collector) == 1 &&
         copy_word(words[6], 1, provision->collector, sizeof provision->collector);
}

bool command_read_calibration(size_t count, char* const* words, struct calibration* calibration) {
  if (count != 4 || strcmp(words[0], "calibrate") != 0) return false;
  unsigned long delay = 0, sigma_mm = 0;
  if (!read_number(words[1], HIGHEST_DELAY, &delay) || !read_number(words[3], HIGHEST_SIGMA_MM, &sigma_mm))
    return false;
  char* end = NULL;
  const double temperature_c = strtod(words[2], &end);
  // Written so that "nan" is refused too.
  if (end == words[2] || *end != '\0' || !(temperature_c >= LEAST_C && temperature_c <= MOST_C)) return false;
  memset(calibration, 0, sizeof *calibration);
  calibration->antenna_delay = (uint32_t)delay;
  calibration->temperature_cc = (int16_t)lround(temperature_c * 100.0);
  calibration->sigma_mm = (uint16_t)sigma_mm;
  return true;
}

bool command_correct_calibration(size_t count, char* const* words, struct calibration* calibration) {
  if (count != 3 || strcmp(words[0], "correct") != 0) return false;
  unsigned long measured_mm = 0, true_mm = 0;
  if (!read_number(words[1], FARTHEST_MM, &measured_mm) || !read_number(words[2], FARTHEST_MM, &true_mm))
    return false;
  const uint32_t delay = calibration_corrected_delay(calibration->antenna_delay, (int32_t)measured_mm * 1000,
                                                     (int32_t)true_mm * 1000);
  if (delay == 0 || delay > HIGHEST_DELAY) return false;  // no antenna's: words mistaken
  calibration->antenna_delay = delay;
  return true;
}
