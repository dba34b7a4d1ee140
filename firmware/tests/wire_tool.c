// Reads datagrams, a line of hexadecimal digits each, and prints what the C codec makes of each: the tests of
// the Python codec compare themselves with it.
#include "wire_text.h"

#define TOO_LONG (WIRE_MAX_SIZE + 64)

int main(void) {
  static char line[2 * TOO_LONG + 2];
  static char text[WIRE_TEXT_SIZE];
  uint8_t key[WIRE_KEY_SIZE], bytes[TOO_LONG];
  wire_text_key(key);
  while (fgets(line, sizeof line, stdin) != NULL) {
    wire_text(bytes, wire_text_bytes(line, bytes, sizeof bytes), key, text);
    puts(text);
  }
  return 0;
}
