// The DW1000 model's registers, power and interrupt, by raw SPI.
#include <array>
#include <cstdint>
#include <random>
#include <vector>

#include "firmware/sim/chip.h"
#include "firmware/tests/sim/chip_bench.h"
#include "tests/cpp/check.h"

namespace {

using namespace bench;

struct One {
  explicit One(const air::Chip::Nature& nature = {}) : ether(events), host(events, ether, nature) {}
  air::Events events;
  Air ether;
  Host host;
};

// A chip whose factory has tuned its LDOs, or has not.
std::uint64_t seed_with(bool ldo_tune) {
  for (std::uint64_t seed = 0;; ++seed) {
    air::Chip::Nature nature;
    nature.seed = seed;
    One one(nature);
    one.host.wait(kMillisecond);
    if ((one.host.read_otp(4) != 0) == ldo_tune) return seed;
  }
}

void it_tells_who_it_is_slowly_at_once_and_fast_after_its_pll_locked() {
  One one;
  one.host.hz = kSlow;
  CHECK(one.host.read(0x00, 0, 4) == 0xDECA0130);
  CHECK((one.host.status() & kCpLock) == 0);
  one.host.wait(100 * kMicrosecond);
  CHECK(one.host.has(kCpLock | kSlp2Init));
  one.host.hz = kFast;
  CHECK(one.host.read(0x00, 0, 4) == 0xDECA0130);
  CHECK(one.host.silent());
}

void fast_spi_before_the_lock_corrupts_bytes_and_is_told() {
  One one, same;
  const auto found = one.host.read_bytes(0x00, 0, 4), again = same.host.read_bytes(0x00, 0, 4);
  CHECK(found == again);  // of the same seed
  int wrong = 0;
  for (int i = 0; i < 50; ++i) wrong += one.host.read(0x00, 0, 4) != 0xDECA0130 ? 1 : 0;
  CHECK(wrong > 40);
  CHECK(one.host.complained("faster than 3 MHz"));
  one.host.write_bytes(0x09, 0, std::vector<std::uint8_t>(100, 0));
  one.host.wait(kMillisecond);
  bool written_wrong = false;
  for (const std::uint8_t byte : one.host.read_bytes(0x09, 0, 100)) written_wrong |= byte != 0;
  CHECK(written_wrong);
}

void forcing_the_crystal_as_clock_makes_fast_spi_wrong_again() {
  One one;
  one.host.wait(kMillisecond);
  one.host.write(0x36, 0, 0x0301, 2);
  CHECK(one.host.silent());
  one.host.read(0x00, 0, 4);
  CHECK(one.host.complained("faster than 3 MHz"));
}

void spi_faster_than_20_mhz_is_told() {
  One one;
  one.host.wait(kMillisecond);
  one.host.hz = 25e6;
  one.host.read(0x00, 0, 4);
  CHECK(one.host.complained("faster than 20 MHz"));
}

void headers_of_one_two_and_three_octets_reach_their_octets() {
  One one;
  one.host.wait(kMillisecond);
  one.host.write(0x03, 0, 0xDECA1234, 4);
  CHECK(one.host.read(0x03, 2, 2) == 0xDECA);
  one.host.write(0x03, 2, 0x5678, 2);
  CHECK(one.host.read(0x03, 0, 4) == 0x56781234);
  one.host.write(0x2E, 0x1804, 0x4034, 2);  // index 0x1804: low seven bits 0x04, then 0x30
  std::array<std::uint8_t, 2> data{};
  const std::array<std::uint8_t, 3> by_hand = {0x6E, 0x84, 0x30};
  one.host.chip.spi(by_hand.data(), 3, data.data(), 2, kFast);
  CHECK(data[0] == 0x34 && data[1] == 0x40);
  CHECK(one.host.silent());
}

void a_header_of_the_wrong_length_does_nothing_and_is_told() {
  One one;
  one.host.wait(kMillisecond);
  std::array<std::uint8_t, 4> data = {1, 2, 3, 4};
  const std::uint8_t one_octet_short = 0x43;
  one.host.chip.spi(&one_octet_short, 1, data.data(), 4, kFast);
  CHECK(data[0] == 0xFF);
  const std::array<std::uint8_t, 2> too_long = {0x83, 0x00};
  one.host.chip.spi(too_long.data(), 2, data.data(), 4, kFast);
  CHECK(one.host.read(0x03, 0, 4) == 0xFFFFFFFF);
  CHECK(one.host.complained("not as long as it says, 2 times"));
}

void what_the_manual_forbids_is_told_once_with_a_count() {
  One one;
  one.host.wait(kMillisecond);
  one.host.read(0x02, 0, 4);
  one.host.read(0x02, 0, 4);
  CHECK(one.host.complained("read of register file 0x02, which is undocumented, 2 times"));
  one.host.write(0x3A, 0, 1, 1);
  CHECK(one.host.complained("write of register file 0x3A"));
  one.host.write(0x00, 0, 0, 4);
  CHECK(one.host.complained("read-only part of register file 0x00"));
  CHECK(one.host.read(0x00, 0, 4) == 0xDECA0130);
  one.host.write(0x18, 1, 0xFFFF, 2);
  CHECK(one.host.complained("write past the end of register file 0x18"));
  CHECK(one.host.read(0x18, 0, 2) == 0xFF00);
  one.host.write(0x2B, 0, 0, 1);
  CHECK(one.host.complained("reserved part of register file 0x2B"));
  CHECK(one.host.read(0x1D, 0, 6) == 0);
  CHECK(one.host.complained("read past the end of register file 0x1D"));
  one.host.read(0x09, 0, 1);
  CHECK(one.host.complained("TX_BUFFER, which can only be written"));
  CHECK(one.host.chip.complaints().size() == 7);
}

void after_a_reset_registers_hold_the_manuals_defaults() {
  One one;
  one.host.wait(kMillisecond);
  one.host.write(0x03, 0, 0x12345678, 4);
  one.host.write(0x18, 0, 0x4000, 2);
  one.host.chip.reset();
  one.host.wait(kMillisecond);
  CHECK(one.host.read(0x03, 0, 4) == 0xFFFFFFFF);
  CHECK(one.host.read(0x01, 0, 8) == 0xFFFFFFFF00000000);
  CHECK(one.host.read(0x04, 0, 4) == 0x00001200);
  CHECK(one.host.read(0x08, 0, 5) == 0x0015400C);
  CHECK(one.host.read(0x18, 0, 2) == 0);
  CHECK(one.host.read(0x1F, 0, 4) == 0x21040055);
  CHECK(one.host.read(0x23, 4, 2) == 0x889B);
  CHECK(one.host.read(0x27, 8, 4) == 0x311E0035);
  CHECK(one.host.read(0x2E, 0x0806, 1) == 0x6C);
  CHECK(one.host.read(0x36, 0, 4) == 0xF0300200);
  CHECK(one.host.silent());
}

void the_counter_goes_at_125_mhz_from_reset_by_the_crystal_and_wraps() {
  air::Chip::Nature nature;
  nature.ppm = 20.0;
  One one(nature);
  one.host.wait(air::kSecond);
  // 63 897 600 000 ticks, and 20 ppm more, in eights of nanoseconds.
  CHECK(one.host.time() == 63'898'877'952 / 512 * 512);
  CHECK(one.host.time() % 512 == 0);
  one.host.chip.reset();
  one.host.wait(kMillisecond);
  CHECK(one.host.time() == std::uint64_t{63'898'877} / 512 * 512);
  one.host.wait(20 * air::kSecond);
  CHECK(one.host.time() == (20 * std::uint64_t{63'898'877'952} + 63'898'877) % kWrap / 512 * 512);
  one.host.chip.crystal().turn(one.events.now(), 0.0);
  const std::uint64_t before = one.host.time();
  one.host.wait(air::kSecond);
  CHECK_NEAR(static_cast<double>(one.host.time() - before), 63'897'600'000.0, 512.0);
}

void ones_clear_status_bits_and_zeros_leave_them() {
  One one;
  one.host.wait(kMillisecond);
  CHECK(one.host.has(kCpLock | kSlp2Init));
  one.host.write(0x0F, 0, 0, 5);
  CHECK(one.host.has(kCpLock | kSlp2Init));
  one.host.write(0x0F, 0, kCpLock, 1);
  CHECK(one.host.status() == kSlp2Init);
  one.host.write(0x0F, 2, 0xFF, 1);
  CHECK(one.host.status() == 0);
  CHECK(one.host.silent());
}

void the_interrupt_is_a_level_of_status_and_mask() {
  One one;
  int rises = 0;
  one.host.chip.on_interrupt = [&] { ++rises; };
  one.host.hz = kSlow;
  one.host.clear();
  one.host.write(0x0E, 0, kCpLock, 4);
  CHECK(!one.host.chip.interrupt());
  one.host.wait(kMillisecond);
  CHECK(one.host.chip.interrupt() && rises == 1);
  CHECK(one.host.has(kIrqs));
  one.host.write(0x0E, 0, kCpLock | kTxFrs, 4);
  CHECK(one.host.chip.interrupt() && rises == 1);  // it was high already
  one.host.write(0x0E, 0, kTxFrs, 4);
  CHECK(!one.host.chip.interrupt());
  CHECK((one.host.status() & kIrqs) == 0);
  one.host.write(0x0E, 0, kCpLock, 4);
  CHECK(one.host.chip.interrupt() && rises == 2);  // the event had not been cleared
  one.host.clear();
  CHECK(!one.host.chip.interrupt());
}

void the_otp_and_the_temperature_can_be_read() {
  air::Chip::Nature nature;
  nature.temperature_c = 57.2;
  nature.seed = seed_with(true);
  One one(nature);
  one.host.wait(kMillisecond);
  const std::uint64_t at_23 = one.host.read_otp(9) & 0xFFU;
  CHECK(at_23 > 0);
  CHECK((one.host.read_otp(0x1E) & 0x1FU) > 0);
  const auto measure = [&] {
    one.host.write(0x28, 0x11, 0x80, 1);
    one.host.write(0x28, 0x12, 0x0A, 1);
    one.host.write(0x28, 0x12, 0x0F, 1);
    one.host.write(0x2A, 0, 1, 1);
    one.host.write(0x2A, 0, 0, 1);
    return (static_cast<double>(one.host.read(0x2A, 4, 1)) - static_cast<double>(at_23)) * 1.14 + 23.0;
  };
  CHECK_NEAR(measure(), 57.2, 0.58);
  one.host.chip.set_temperature(-20.0);
  CHECK_NEAR(measure(), -20.0, 0.58);
  one.host.load_ldo_tune();
  CHECK(one.host.read(0x28, 0x30, 4) == one.host.read_otp(4));
  CHECK(one.host.silent());
  one.host.write(0x28, 0x12, 0x00, 1);
  one.host.write(0x2A, 0, 1, 1);
  CHECK(one.host.complained("sensor off"));
}

void the_otp_wants_the_crystal_as_clock() {
  One one;
  one.host.wait(kMillisecond);
  const std::uint64_t right = one.host.read_otp(9);
  CHECK(one.host.read_otp(9) == right && one.host.silent());
  one.host.write(0x2D, 6, 0x03, 1);
  CHECK(one.host.read(0x2D, 0x0A, 4) != right);
  CHECK(one.host.complained("OTP"));
}

void a_soft_reset_wants_the_crystal_as_clock_and_forgets_registers() {
  One one;
  one.host.wait(kMillisecond);
  one.host.write(0x03, 0, 0x12345678, 4);
  one.host.hz = kSlow;
  one.host.write(0x36, 0, 0x0201, 2);
  one.host.write(0x36, 3, 0x00, 1);
  one.host.write(0x36, 3, 0xF0, 1);
  one.host.write(0x36, 0, 0x0200, 2);
  CHECK(one.host.read(0x03, 0, 4) == 0xFFFFFFFF);
  CHECK(one.host.silent());
  one.host.wait(kMillisecond);
  one.host.write(0x36, 3, 0x00, 1);
  CHECK(one.host.complained("soft reset"));
}

void sleep(Host& host, std::uint64_t wake_up, std::uint64_t sources = 0x05) {
  host.write(0x2C, 0x0A, 0, 2);
  host.write(0x2C, 0, wake_up, 2);
  host.write(0x2C, 6, sources, 1);
  host.write(0x2C, 2, 0x00, 1);
  host.write(0x2C, 2, 0x02, 1);
}

constexpr std::uint64_t kLoadAll = 0x0040 | 0x0800 | 0x1000;

void deep_sleep_keeps_configuration_and_forgets_the_rest() {
  One one;
  one.host.configure();
  one.host.write(0x01, 0, 0x1122334455667788, 8);
  one.host.write(0x03, 0, 0xDECA0007, 4);
  one.host.write(0x18, 0, 0x4034, 2);
  one.host.write(0x2E, 0x1804, 0x4035, 2);
  one.host.write(0x36, 2, 0x34, 1);  // GPDCE set
  sleep(one.host, kLoadAll);
  CHECK(one.host.chip.asleep());
  CHECK(!one.host.chip.interrupt());
  CHECK(one.host.read(0x00, 0, 4) == 0xFFFFFFFF);
  CHECK(one.host.silent());

  one.host.wait(499 * kMicrosecond);
  one.host.chip.select_for(499 * kMicrosecond);
  CHECK(one.host.chip.asleep());
  one.host.wait(kMicrosecond);
  one.host.chip.select_for(500 * kMicrosecond);
  CHECK(!one.host.chip.asleep());
  one.host.wait(2 * kMillisecond);
  CHECK(one.host.read(0x00, 0, 4) == 0xFFFFFFFF);  // the crystal does not swing yet
  one.host.wait(kMillisecond);
  one.host.hz = kSlow;
  CHECK(one.host.read(0x00, 0, 4) == 0xDECA0130);
  CHECK(one.host.time() < std::uint64_t{6'389'800});  // began anew less than 100 us ago
  one.host.wait(kMillisecond);
  CHECK(one.host.has(kSlp2Init | kCpLock));
  one.host.hz = kFast;
  CHECK(one.host.read(0x03, 0, 4) == 0xDECA0007);
  CHECK(one.host.read(0x1F, 0, 4) == 0x4A480055);
  CHECK(one.host.read(0x27, 8, 4) == 0x313B006B);
  CHECK(one.host.read(0x2E, 0x1804, 2) == 0x4035);
  CHECK(one.host.read(0x01, 0, 8) == 0xFFFFFFFF00000000);
  CHECK(one.host.read(0x18, 0, 2) == 0x40);  // the high octet of the receiver's delay
  CHECK((one.host.read(0x36, 2, 1) & 0x04U) == 0);
  one.host.listen();
  one.host.wait(kMillisecond);
  CHECK(one.host.silent());
}

void what_is_not_asked_for_is_not_there_after_sleep() {
  air::Chip::Nature nature;
  nature.seed = seed_with(true);
  One one(nature);
  one.host.configure();
  sleep(one.host, 0x0040);
  one.host.chip.select_for(600 * kMicrosecond);
  one.host.wait(4 * kMillisecond);
  one.host.listen();
  CHECK(one.host.complained("without the LDE microcode"));
  CHECK(one.host.complained("LDOTUNE"));
  CHECK(one.host.chip.complaints().size() == 2);

  one.host.control(kOff);
  sleep(one.host, 0x0800 | 0x1000);
  one.host.chip.select_for(600 * kMicrosecond);
  one.host.wait(4 * kMillisecond);
  CHECK(one.host.read(0x1F, 0, 4) == 0x21040055);
}

void temperature_is_measured_on_waking_if_asked_for() {
  for (const bool asked : {false, true}) {
    One one;
    one.host.configure();
    one.host.chip.set_temperature(45.8);  // 20 steps
    sleep(one.host, asked ? kLoadAll | 0x0001 : kLoadAll);
    one.host.chip.select_for(600 * kMicrosecond);
    one.host.wait(4 * kMillisecond);
    const std::uint64_t at_23 = one.host.read_otp(9);
    CHECK(one.host.read(0x2A, 7, 1) == (asked ? at_23 + 20 : 0));
    CHECK(one.host.read(0x2A, 6, 1) == (asked ? one.host.read_otp(8) : 0));
  }
}

void a_slow_long_read_wakes_too_and_a_write_to_a_sleeper_is_told() {
  One one;
  one.host.configure();
  sleep(one.host, kLoadAll);
  one.host.read_bytes(0x00, 0, 100);  // 40 us
  CHECK(one.host.chip.asleep());
  one.host.write(0x18, 0, 1, 2);
  CHECK(one.host.complained("a write while asleep"));
  one.host.hz = 1e6;
  one.host.read_bytes(0x00, 0, 100);  // 800 us
  CHECK(!one.host.chip.asleep());
}

void sleep_without_what_it_needs_is_told() {
  One one;
  one.host.configure();
  one.host.write(0x2C, 6, 0x01, 1);
  one.host.write(0x2C, 2, 0x02, 1);
  CHECK(one.host.chip.asleep());
  CHECK(one.host.complained("AON_CFG1"));
  CHECK(one.host.complained("chip select does not wake"));
  one.host.chip.select_for(kMillisecond);
  CHECK(one.host.chip.asleep());
  one.host.chip.reset();  // it holds that line low itself
  CHECK(one.host.chip.asleep());
  one.host.chip.power(false);
  one.host.chip.power(true);
  CHECK(!one.host.chip.asleep());
}

void a_reset_after_sleep_loads_what_sleep_had_saved() {
  One one;
  one.host.configure();
  sleep(one.host, 0x0040);
  one.host.chip.select_for(600 * kMicrosecond);
  one.host.wait(4 * kMillisecond);
  one.host.write(0x1F, 0, 0x4A480022, 4);
  one.host.chip.reset();
  one.host.wait(kMillisecond);
  CHECK(one.host.read(0x1F, 0, 4) == 0x4A480055);
  CHECK(one.host.read(0x2C, 0, 2) == 0x0040);
  one.host.write(0x2C, 0, 0, 2);
  one.host.write(0x2C, 6, 0, 1);
  one.host.write(0x2C, 2, 0x04, 1);  // uploaded
  one.host.chip.reset();
  one.host.wait(kMillisecond);
  CHECK(one.host.read(0x1F, 0, 4) == 0x21040055);
  CHECK(one.host.silent());
}

void without_power_nobody_answers_and_everything_is_forgotten() {
  One one;
  one.host.configure();
  sleep(one.host, kLoadAll);
  one.host.chip.power(false);
  CHECK(!one.host.chip.asleep() && !one.host.chip.interrupt());
  CHECK(one.host.read(0x00, 0, 4) == 0xFFFFFFFF);
  one.host.write(0x18, 0, 1, 2);
  one.host.chip.reset();
  one.host.chip.select_for(kMillisecond);
  one.host.wait(air::kSecond);
  CHECK(one.host.read(0x00, 0, 4) == 0xFFFFFFFF);
  one.host.chip.power(true);
  one.host.wait(kMillisecond);
  CHECK(one.host.read(0x1F, 0, 4) == 0x21040055);
  CHECK(one.host.read(0x2C, 0, 2) == 0);
  CHECK(one.host.time() <= 63'897'600);
  CHECK(one.host.silent());
}

void microcode_loads_only_with_its_clocks_for_150_us() {
  One one;
  one.host.configure();
  one.host.chip.reset();
  one.host.wait(kMillisecond);
  one.host.write(0x2D, 6, 0x8000, 2);
  CHECK(one.host.complained("without the clocks"));
  one.host.hz = kSlow;
  one.host.write(0x36, 0, 0x0301, 2);
  one.host.write(0x2D, 6, 0x8000, 2);
  one.host.wait(149 * kMicrosecond);
  one.host.write(0x36, 0, 0x0200, 2);
  CHECK(one.host.complained("clocks changed"));
  one.host.listen();
  CHECK(one.host.complained("without the LDE microcode"));
}

// Whatever a host sends over SPI, at whatever moment.
void random_transactions_never_break_it() {
  std::mt19937_64 random(7);
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    air::Chip::Nature nature;
    nature.seed = seed;
    Pair pair(nature, nature);
    for (int i = 0; i < 1'000; ++i) {
      Host& host = (random() & 1U) != 0 ? pair.a : pair.b;
      std::array<std::uint8_t, 3> header{};
      for (std::uint8_t& byte : header) byte = static_cast<std::uint8_t>(random());
      // Half of them of a shape that reaches registers that do something.
      constexpr std::array<std::uint8_t, 14> kLively = {0x04, 0x08, 0x09, 0x0A, 0x0C, 0x0D, 0x0E,
                                                        0x0F, 0x1F, 0x27, 0x2A, 0x2C, 0x2D, 0x36};
      if ((random() & 1U) != 0)
        header[0] = static_cast<std::uint8_t>(0x80U | kLively[random() % kLively.size()]);
      std::vector<std::uint8_t> data(random() % 8 == 0 ? random() % 1'200 : random() % 6);
      for (std::uint8_t& byte : data) byte = static_cast<std::uint8_t>(random() >> random() % 8);
      host.chip.spi(header.data(), 1 + random() % 3, data.data(), data.size(),
                    (random() & 1U) != 0 ? kSlow : kFast);
      if (random() % 8 == 0) host.listen();
      if (random() % 8 == 0) host.send(2 + random() % 126);
      if (random() % 50 == 0) host.chip.select_for(kMillisecond);
      if (random() % 100 == 0) host.chip.reset();
      if (random() % 4 == 0) pair.run(static_cast<Femto>(random() % 1000) * kMicrosecond);
    }
    pair.run(20 * air::kSecond);
  }
  CHECK(true);
}

}  // namespace

int main() {
  it_tells_who_it_is_slowly_at_once_and_fast_after_its_pll_locked();
  fast_spi_before_the_lock_corrupts_bytes_and_is_told();
  forcing_the_crystal_as_clock_makes_fast_spi_wrong_again();
  spi_faster_than_20_mhz_is_told();
  headers_of_one_two_and_three_octets_reach_their_octets();
  a_header_of_the_wrong_length_does_nothing_and_is_told();
  what_the_manual_forbids_is_told_once_with_a_count();
  after_a_reset_registers_hold_the_manuals_defaults();
  the_counter_goes_at_125_mhz_from_reset_by_the_crystal_and_wraps();
  ones_clear_status_bits_and_zeros_leave_them();
  the_interrupt_is_a_level_of_status_and_mask();
  the_otp_and_the_temperature_can_be_read();
  the_otp_wants_the_crystal_as_clock();
  a_soft_reset_wants_the_crystal_as_clock_and_forgets_registers();
  deep_sleep_keeps_configuration_and_forgets_the_rest();
  what_is_not_asked_for_is_not_there_after_sleep();
  temperature_is_measured_on_waking_if_asked_for();
  a_slow_long_read_wakes_too_and_a_write_to_a_sleeper_is_told();
  sleep_without_what_it_needs_is_told();
  a_reset_after_sleep_loads_what_sleep_had_saved();
  without_power_nobody_answers_and_everything_is_forgotten();
  microcode_loads_only_with_its_clocks_for_150_us();
  random_transactions_never_break_it();
  return check::verdict();
}
