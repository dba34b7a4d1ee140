#include "dw1000_power.h"

#include "dw1000.h"

#define LOG_ONE 65536  // fixed point

// log2(x) for x > 0, to 1/65536: the next bit of a logarithm is whether the square of the mantissa reaches 2.
static int32_t log2_of(uint64_t x) {
  int32_t whole = 31;
  for (; x >= UINT64_C(1) << 32; x >>= 1) ++whole;
  for (; x < UINT64_C(1) << 31; x <<= 1) --whole;
  int32_t log = whole * LOG_ONE;
  for (int32_t bit = LOG_ONE / 2; bit > 0; bit /= 2) {
    x = x * x >> 31;
    if (x >= UINT64_C(1) << 32) {
      x >>= 1;
      log += bit;
    }
  }
  return log;
}

// 10 log10(power / symbols^2) - A, within 0.01 dB.
static int16_t cdbm_of(const struct dw1000_prf* prf, int32_t log2_power, uint16_t symbols) {
  const int64_t log = (int64_t)log2_power - 2 * (int64_t)log2_of(symbols);
  const int64_t scaled = log * 30103;  // 1000 log10(2) = 301.03
  const int64_t one = (int64_t)100 * LOG_ONE;
  const int64_t cdb = (scaled + (scaled < 0 ? -one : one) / 2) / one;
  return (int16_t)(cdb - prf->power_constant_cdb);
}

int16_t dw1000_first_path_cdbm(const struct dw1000_prf* prf, uint16_t f1, uint16_t f2, uint16_t f3,
                               uint16_t symbols) {
  const uint64_t power = (uint64_t)f1 * f1 + (uint64_t)f2 * f2 + (uint64_t)f3 * f3;
  if (power == 0 || symbols == 0) return DW1000_UNKNOWN_POWER;
  return cdbm_of(prf, log2_of(power), symbols);
}

int16_t dw1000_received_cdbm(const struct dw1000_prf* prf, uint16_t cir_power, uint16_t symbols) {
  if (cir_power == 0 || symbols == 0) return DW1000_UNKNOWN_POWER;
  return cdbm_of(prf, log2_of(cir_power) + 17 * LOG_ONE, symbols);
}

uint16_t dw1000_symbols(uint16_t rxpacc, uint16_t rxpacc_nosat) {
  if (rxpacc != rxpacc_nosat) return rxpacc;
  return rxpacc > DW1000_SFD_ACCUMULATED ? (uint16_t)(rxpacc - DW1000_SFD_ACCUMULATED) : 0;
}
