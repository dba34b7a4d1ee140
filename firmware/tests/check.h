// All that the tests need of a framework, on the host and on a board alike.
#pragma once

#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>

static int check_failures;

static inline void check_equal(int64_t found, int64_t expected, const char* what, const char* file,
                               int line) {
  if (found == expected) return;
  ++check_failures;
  printf("%s:%d: %s is %" PRId64 ", not %" PRId64 "\n", file, line, what, found, expected);
}

static inline void check_within(int64_t found, int64_t least, int64_t most, const char* what,
                                const char* file, int line) {
  if (least <= found && found <= most) return;
  ++check_failures;
  printf("%s:%d: %s is %" PRId64 ", not within %" PRId64 " and %" PRId64 "\n", file, line, what, found, least,
         most);
}

static inline int check_verdict(void) { return check_failures == 0 ? 0 : 1; }

#define CHECK_EQUAL(found, expected) \
  check_equal((int64_t)(found), (int64_t)(expected), #found, __FILE__, __LINE__)
#define CHECK_WITHIN(found, least, most) \
  check_within((int64_t)(found), (int64_t)(least), (int64_t)(most), #found, __FILE__, __LINE__)
#define CHECK(condition) check_equal((condition) ? 1 : 0, 1, #condition, __FILE__, __LINE__)
