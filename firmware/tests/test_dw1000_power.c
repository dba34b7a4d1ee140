#include "check.h"
#include "dw1000.h"
#include "dw1000_power.h"

static const struct dw1000_prf *const prf_16 = &dw1000_prfs[0], *const prf_64 = &dw1000_prfs[1];

// 100 (10 log10((F1^2 + F2^2 + F3^2) / N^2) - A), in double precision.
static void power_of_the_first_path_is_that_of_the_manual(void) {
  CHECK_EQUAL(dw1000_first_path_cdbm(prf_64, 10000, 9000, 8000, 120), -7943);   // -7943.20
  CHECK_EQUAL(dw1000_first_path_cdbm(prf_16, 10000, 9000, 8000, 120), -7146);   // -7146.20
  CHECK_EQUAL(dw1000_first_path_cdbm(prf_64, 5432, 4321, 3210, 113), -8513);    // -8513.14
  CHECK_EQUAL(dw1000_first_path_cdbm(prf_16, 300, 200, 100, 64), -9843);        // -9843.23
  CHECK_WITHIN(dw1000_first_path_cdbm(prf_64, 1, 0, 0, 4095), -19399, -19398);  // -19398.51
  CHECK_EQUAL(dw1000_first_path_cdbm(prf_64, 65535, 65535, 65535, 1), -2064);   // -2063.93
}

// 100 (10 log10(C 2^17 / N^2) - A).
static void received_power_is_that_of_the_manual(void) {
  CHECK_EQUAL(dw1000_received_cdbm(prf_64, 5000, 120), -7516);   // -7515.88
  CHECK_EQUAL(dw1000_received_cdbm(prf_16, 5000, 120), -6719);   // -6718.88
  CHECK_EQUAL(dw1000_received_cdbm(prf_64, 12345, 113), -7071);  // -7071.16
  CHECK_EQUAL(dw1000_received_cdbm(prf_16, 777, 64), -6981);     // -6981.43
  CHECK_EQUAL(dw1000_received_cdbm(prf_64, 1, 4095), -14281);    // -14281.00
  CHECK_EQUAL(dw1000_received_cdbm(prf_64, 65535, 1), -2240);    // -2240.02
}

static void ten_times_the_amplitude_is_20_db_and_ten_times_the_symbols_minus_20(void) {
  for (uint16_t f = 1; f <= 6553; f = (uint16_t)(f + 13)) {
    const int one = dw1000_first_path_cdbm(prf_64, f, 0, 0, 100);
    CHECK_WITHIN(dw1000_first_path_cdbm(prf_64, (uint16_t)(10 * f), 0, 0, 100) - one, 1999, 2001);
    CHECK_WITHIN(dw1000_first_path_cdbm(prf_64, f, 0, 0, 1000) - one, -2001, -1999);
  }
}

static void more_power_never_reads_as_less(void) {
  int before = dw1000_received_cdbm(prf_64, 1, 128);
  for (unsigned power = 2; power <= 65535; power += 7) {
    const int now = dw1000_received_cdbm(prf_64, (uint16_t)power, 128);
    CHECK(now >= before);
    before = now;
  }
}

static void nothing_accumulated_is_no_power(void) {
  CHECK_EQUAL(dw1000_first_path_cdbm(prf_64, 0, 0, 0, 120), DW1000_UNKNOWN_POWER);
  CHECK_EQUAL(dw1000_first_path_cdbm(prf_64, 1, 2, 3, 0), DW1000_UNKNOWN_POWER);
  CHECK_EQUAL(dw1000_received_cdbm(prf_64, 0, 120), DW1000_UNKNOWN_POWER);
  CHECK_EQUAL(dw1000_received_cdbm(prf_64, 5000, 0), DW1000_UNKNOWN_POWER);
}

static void symbols_of_the_sfd_are_taken_off_unless_the_counter_had_stopped(void) {
  CHECK_EQUAL(dw1000_symbols(128, 128), 123);
  CHECK_EQUAL(dw1000_symbols(118, 128), 118);
  CHECK_EQUAL(dw1000_symbols(6, 6), 1);
  CHECK_EQUAL(dw1000_symbols(5, 5), 0);
  CHECK_EQUAL(dw1000_symbols(0, 0), 0);
}

int main(void) {
  power_of_the_first_path_is_that_of_the_manual();
  received_power_is_that_of_the_manual();
  ten_times_the_amplitude_is_20_db_and_ten_times_the_symbols_minus_20();
  more_power_never_reads_as_less();
  nothing_accumulated_is_no_power();
  symbols_of_the_sfd_are_taken_off_unless_the_counter_had_stopped();
  return check_verdict();
}
