// What loops over many ranges need so that compilers vectorise them: an exponential and a logarithm without
// branches or calls, and code for what the processor has.
#pragma once

#include <cstdint>
#include <cstring>

// A function that is written as `SYNCHRONIZAR_INLINE` is compiled for AVX2 as well where it is called from
// one that is marked `SYNCHRONIZAR_AVX2`, which is to be called where `has_avx2`.
#if defined(__GNUC__) && defined(__x86_64__)
#define SYNCHRONIZAR_AVX2 __attribute__((target("avx2,fma")))
#define SYNCHRONIZAR_INLINE inline __attribute__((always_inline))
#else
#define SYNCHRONIZAR_AVX2
#define SYNCHRONIZAR_INLINE inline
#endif

namespace synchronizar {

inline bool has_avx2() {
#if defined(__GNUC__) && defined(__x86_64__)
  static const bool has = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  return has;
#else
  return false;
#endif
}

constexpr double kLogOf2 = 0.693147180559945309417;

SYNCHRONIZAR_INLINE std::uint64_t bits_of(double x) {
  std::uint64_t out;
  std::memcpy(&out, &x, sizeof out);
  return out;
}

SYNCHRONIZAR_INLINE double double_of(std::uint64_t bits) {
  double out;
  std::memcpy(&out, &bits, sizeof out);
  return out;
}

// exp(x) for x <= 0 to a few units in the last place; exp(-700) below.
SYNCHRONIZAR_INLINE double exp_of_negative(double x) {
  constexpr double kPerLog2 = 1.4426950408889634, kRound = 6755399441055744.0;  // 1.5 * 2^52
  constexpr double kLog2High = 0.693147180369123816490, kLog2Low = 1.90821492927058770002e-10;
  x = x > -700.0 ? x : -700.0;
  const double shifted = x * kPerLog2 + kRound;
  const double whole = shifted - kRound;
  const double r = (x - whole * kLog2High) - whole * kLog2Low;
  // By pairs of terms, which do not wait for each other.
  const double r2 = r * r, r4 = r2 * r2, r8 = r4 * r4;
  const double p0 = 1.0 + r, p2 = 0.5 + r * (1.0 / 6.0), p4 = 1.0 / 24.0 + r * (1.0 / 120.0);
  const double p6 = 1.0 / 720.0 + r * (1.0 / 5040.0), p8 = 1.0 / 40320.0 + r * (1.0 / 362880.0);
  const double p10 = 1.0 / 3628800.0 + r * (1.0 / 39916800.0);
  const double p = ((p0 + r2 * p2) + r4 * (p4 + r2 * p6)) + r8 * ((p8 + r2 * p10) + r4 * (1.0 / 479001600.0));
  return double_of(bits_of(p) + (bits_of(shifted) << 52U));
}

// A normal x > 0 as mantissa * 2^exponent, the mantissa from the root of a half to the root of two.
struct Split {
  double mantissa, exponent;
};

SYNCHRONIZAR_INLINE Split split_of(double x) {
  constexpr std::uint64_t kOne = 0x3ff0000000000000, kRootHalf = 0x3fe6a09e667f3bcd;
  constexpr std::uint64_t kTwo52 = 0x4330000000000000;
  const std::uint64_t exponent = (bits_of(x) + (kOne - kRootHalf)) >> 52U;  // of x over the root of a half
  return {double_of(bits_of(x) - (exponent << 52U) + kOne),
          double_of(exponent | kTwo52) - (4503599627370496.0 + 1023.0)};
}

// log(x) of a normal x > 0, to a few units in the last place of the larger of it and 1.
SYNCHRONIZAR_INLINE double log_of_normal(double x) {
  const Split split = split_of(x);
  const double f = (split.mantissa - 1.0) / (split.mantissa + 1.0), f2 = f * f;
  double p = 1.0 / 21.0;
  p = p * f2 + 1.0 / 19.0;
  p = p * f2 + 1.0 / 17.0;
  p = p * f2 + 1.0 / 15.0;
  p = p * f2 + 1.0 / 13.0;
  p = p * f2 + 1.0 / 11.0;
  p = p * f2 + 1.0 / 9.0;
  p = p * f2 + 1.0 / 7.0;
  p = p * f2 + 0.2;
  p = p * f2 + 1.0 / 3.0;
  p = p * f2 + 1.0;
  return split.exponent * kLogOf2 + 2.0 * f * p;
}

// The same of floats; exp(-87) below.
SYNCHRONIZAR_INLINE float exp_of_negative(float x) {
  constexpr float kPerLog2 = 1.44269504F, kRound = 12582912.0F;  // 1.5 * 2^23
  constexpr float kLog2High = 0.693359375F, kLog2Low = -2.12194440e-4F;
  x = x > -87.0F ? x : -87.0F;
  const float shifted = x * kPerLog2 + kRound;
  const float whole = shifted - kRound;
  const float r = (x - whole * kLog2High) - whole * kLog2Low;
  float p = 1.0F / 5040.0F;
  p = p * r + 1.0F / 720.0F;
  p = p * r + 1.0F / 120.0F;
  p = p * r + 1.0F / 24.0F;
  p = p * r + 1.0F / 6.0F;
  p = p * r + 0.5F;
  p = p * r + 1.0F;
  p = p * r + 1.0F;
  std::uint32_t of_p, of_shifted;
  std::memcpy(&of_p, &p, sizeof p);
  std::memcpy(&of_shifted, &shifted, sizeof shifted);
  of_p += of_shifted << 23U;
  std::memcpy(&p, &of_p, sizeof p);
  return p;
}

}  // namespace synchronizar
