// All that the tests need of a framework: a check that fails tells where and what, and main returns the
// verdict.
#pragma once

#include <cmath>
#include <iostream>

namespace check {

inline int failures = 0;

inline void near(double found, double expected, double tolerance, const char* what, const char* file,
                 int line) {
  if (std::abs(found - expected) <= tolerance) return;  // NaN is near nothing
  ++failures;
  std::cerr.precision(17);
  std::cerr << file << ':' << line << ": " << what << " is " << found << ", not " << expected << " (+- "
            << tolerance << ")\n";
}

inline int verdict() { return failures == 0 ? 0 : 1; }

}  // namespace check

#define CHECK_NEAR(found, expected, tolerance) \
  check::near(found, expected, tolerance, #found, __FILE__, __LINE__)
#define CHECK(condition) check::near((condition) ? 1.0 : 0.0, 1.0, 0.0, #condition, __FILE__, __LINE__)
