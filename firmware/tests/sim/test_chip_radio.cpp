// The DW1000 model on the air: sending, receiving, stamps, and what goes wrong.
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "firmware/sim/chip.h"
#include "firmware/sim/chip_airtime.h"
#include "firmware/tests/sim/chip_bench.h"
#include "tests/cpp/check.h"

namespace {

using namespace bench;

constexpr std::uint64_t kTicksPerMs = 63'897'600;

double microseconds(Femto time) { return air::to_seconds(time) * 1e6; }

std::int64_t difference(std::uint64_t later, std::uint64_t earlier) {
  const std::uint64_t ahead = (later - earlier) % kWrap;
  return ahead >= kWrap / 2 ? static_cast<std::int64_t>(ahead) - static_cast<std::int64_t>(kWrap)
                            : static_cast<std::int64_t>(ahead);
}

// CRC-16/KERMIT's published check value for "123456789".
void the_fcs_is_that_of_802_15_4() {
  Pair pair;
  pair.a.write_bytes(0x09, 0, {'1', '2', '3', '4', '5', '6', '7', '8', '9'});
  pair.a.write(0x08, 0, 0x00164000 | 11, 5);
  pair.a.control(kStart);
  pair.run(kMillisecond);
  CHECK(pair.ether.sent.size() == 1);
  CHECK(pair.ether.sent[0].bytes.size() == 11);
  CHECK(pair.ether.sent[0].bytes[9] == 0x89 && pair.ether.sent[0].bytes[10] == 0x21);
}

void airtimes_are_those_of_the_standard() {
  const auto time = [](const air::Phy& phy, std::size_t bytes) {
    return microseconds(air::nominal_time(air::preamble_ticks(phy) + air::sfd_ticks(phy) +
                                          air::header_ticks(phy) + air::data_ticks(phy, bytes)));
  };
  const air::Phy fast{6800, 64, 128};
  CHECK_NEAR(time(fast, 12), 178, 0.5);
  CHECK_NEAR(time(fast, 30), 197, 0.5);
  CHECK_NEAR(time(fast, 60), 234, 0.5);
  CHECK_NEAR(time(fast, 100), 281, 0.5);
  CHECK_NEAR(time(fast, 127), 315, 0.5);
  const air::Phy slow{110, 64, 1024};
  CHECK_NEAR(time(slow, 12), 2461, 0.5);
  CHECK_NEAR(time(slow, 30), 3643, 0.5);
  CHECK_NEAR(microseconds(air::nominal_time(1000 * air::symbol_ticks(fast))), 1017.63, 0.005);
  CHECK_NEAR(microseconds(air::nominal_time(1000 * air::symbol_ticks({6800, 16, 128}))), 993.59, 0.005);
}

void sending_tells_its_progress_and_takes_the_airtime() {
  Pair pair;
  pair.a.send(12);
  pair.run(11 * kMicrosecond);
  CHECK(pair.a.status() == kTxFrb);
  const air::Emission& sent = pair.ether.sent.at(0);
  CHECK_NEAR(microseconds(sent.marker - sent.begin), 136 * 1.01763, 0.01);
  CHECK_NEAR(microseconds(sent.end - sent.begin), 178.4, 0.1);
  CHECK(sent.channel == 5 && sent.prf_mhz == 64 && sent.preamble_code == 9);
  pair.events.run_until(sent.marker - 9 * kMicrosecond);
  CHECK(pair.a.status() == kTxFrb);
  pair.events.run_until(sent.marker);
  CHECK(pair.a.status() == (kTxFrb | kTxPrs));
  pair.events.run_until(sent.marker + 22 * kMicrosecond);
  CHECK(pair.a.status() == (kTxFrb | kTxPrs | kTxPhs));
  pair.events.run_until(sent.end - 1);
  CHECK(!pair.a.has(kTxFrs));
  pair.events.run_until(sent.end);
  CHECK(pair.a.status() == (kTxFrb | kTxPrs | kTxPhs | kTxFrs));
  pair.a.send(12);
  CHECK(pair.a.status() == 0);  // the next transmission clears them
  CHECK(pair.a.silent());
}

void a_frame_comes_in_with_its_events_in_order_and_the_receiver_is_off_afterwards() {
  Pair pair;
  pair.b.write(0x0E, 0, kRxFcg, 4);
  pair.b.listen();
  pair.run(kMillisecond);
  pair.a.send(30);
  pair.run(20 * kMicrosecond);
  const air::Emission sent = pair.ether.sent.at(0);
  const Femto marker = sent.marker + pair.ether.flight;
  pair.events.run_until(marker - 10 * kMicrosecond);
  CHECK(pair.b.status() == kRxPrd);
  pair.events.run_until(marker);
  CHECK(pair.b.status() == (kRxPrd | kRxSfdd));
  pair.events.run_until(marker + 15 * kMicrosecond);
  CHECK(pair.b.status() == (kRxPrd | kRxSfdd | kLdeDone));
  pair.events.run_until(marker + 22 * kMicrosecond);
  CHECK(pair.b.status() == (kRxPrd | kRxSfdd | kLdeDone | kRxPhd));
  CHECK(!pair.b.chip.interrupt());
  pair.events.run_until(sent.end + pair.ether.flight);
  CHECK(pair.b.status() == (kGood | kIrqs));
  CHECK(pair.b.chip.interrupt());
  CHECK((pair.b.read(0x10, 0, 4) & 0x3FFU) == 30);
  CHECK((pair.b.read(0x10, 0, 4) & 0x000FF800U) == 0x00064800U);  // 6.8 Mb/s, PRF 64, 128 symbols
  CHECK(pair.b.read_bytes(0x11, 0, 30) == sent.bytes);
  CHECK(pair.b.read_bytes(0x11, 0, 28) ==
        std::vector<std::uint8_t>(sent.bytes.begin(), sent.bytes.end() - 2));

  pair.b.clear();
  pair.a.send(30);
  pair.run(kMillisecond);
  CHECK(pair.b.status() == 0);
  CHECK(pair.a.silent() && pair.b.silent());
}

// Whatever the clocks are off, a round of three frames brings out the time of flight (UM 12.3.2), here in
// floating point.
void the_time_of_flight_comes_out_of_the_stamps() {
  for (const double ppm : {0.0, 20.0, -20.0}) {
    air::Chip::Nature a_nature, b_nature;
    a_nature.ppm = ppm;
    b_nature.ppm = -ppm;
    a_nature.tx_delay = a_nature.rx_delay = 257'000'000;
    b_nature.tx_delay = 250'000'000;
    b_nature.rx_delay = 261'000'000;
    Pair pair(a_nature, b_nature);
    const auto ticks_of = [](Femto delay) {
      return static_cast<std::uint64_t>(std::llround(air::to_seconds(delay) * 63.8976e9));
    };
    const auto set_delays = [&](Host& host, const air::Chip::Nature& nature) {
      host.write(0x18, 0, ticks_of(nature.tx_delay), 2);
      host.write(0x2E, 0x1804, ticks_of(nature.rx_delay), 2);
    };
    set_delays(pair.a, a_nature);
    set_delays(pair.b, b_nature);
    std::array<std::uint64_t, 3> sent{}, received{};
    pair.b.listen();
    for (std::size_t i = 0; i < 3; ++i) {
      Host& from = i == 1 ? pair.b : pair.a;
      Host& to = i == 1 ? pair.a : pair.b;
      if (i > 0) to.listen();
      const std::uint64_t moment = from.time() + kTicksPerMs + 0x123;
      from.send_at(moment, 12);
      pair.run(2 * kMillisecond);
      CHECK(from.has(kTxFrs) && to.has(kRxFcg | kLdeDone));
      sent[i] = from.tx_stamp();
      CHECK(sent[i] == (moment % kWrap / 512 * 512 + from.read(0x18, 0, 2)) % kWrap);
      CHECK(from.read(0x17, 5, 5) == moment % kWrap / 512 * 512);
      received[i] = to.rx_stamp();
    }
    const auto ra = static_cast<double>(difference(received[1], sent[0]));
    const auto rb = static_cast<double>(difference(received[2], sent[1]));
    const auto da = static_cast<double>(difference(sent[2], received[1]));
    const auto db = static_cast<double>(difference(sent[1], received[0]));
    const double flight = air::to_seconds(pair.ether.flight) * 63.8976e9;
    CHECK_NEAR((ra * rb - da * db) / (ra + rb + da + db), flight, 1.0);
    CHECK(pair.a.silent() && pair.b.silent());
  }
}

void the_receivers_stamp_is_its_counter_less_its_antenna_delay_and_wraps() {
  air::Chip::Nature nature;
  nature.rx_delay = 257'543'000;  // 16 456.38 ticks
  Pair pair({}, nature);
  pair.b.write(0x2E, 0x1804, 16'456, 2);
  pair.ether.stamp_error = 78'250;  // 5 ticks
  for (int i = 0; i < 40; ++i) {
    pair.b.listen();
    pair.run(kMillisecond);
    pair.a.send(12);
    pair.run(431 * kMillisecond);
    CHECK(pair.b.has(kRxFcg | kLdeDone));
    const double at =
        air::to_seconds(pair.ether.sent.back().marker + pair.ether.flight + 78'250 + 543'000 - 526'000);
    CHECK_NEAR(std::remainder(static_cast<double>(pair.b.rx_stamp()) - at * 63.8976e9, std::ldexp(1.0, 40)),
               0.0, 1.0);
    CHECK(pair.b.rx_stamp() < kWrap);
  }
}

void transmit_stamps_know_the_register_not_the_antenna() {
  air::Chip::Nature nature;
  nature.tx_delay = 500'000'000;
  Pair pair(nature, {});
  pair.a.write(0x18, 0, 100, 2);
  const std::uint64_t moment = (pair.a.time() + kTicksPerMs) & ~std::uint64_t{0x1FF};
  pair.a.send_at(moment + 0x1FF);
  pair.run(2 * kMillisecond);
  CHECK(pair.a.tx_stamp() == moment + 100);
  // 500 ns after the counter came there.
  CHECK_NEAR(air::to_seconds(pair.ether.sent.at(0).marker) * 63.8976e9,
             static_cast<double>(moment) + 31'948.8, 1.0);
}

void a_moment_that_has_passed_is_warned_of_and_nothing_sent_for_a_period() {
  Pair pair;
  pair.a.write(0x0E, 0, kHpdWarn, 4);
  pair.a.send_at(pair.a.time() - 1000);
  CHECK(pair.a.has(kHpdWarn));
  CHECK(pair.a.chip.interrupt());
  pair.a.clear();
  CHECK(pair.a.has(kHpdWarn));  // read only
  pair.run(8 * air::kSecond);
  CHECK(pair.a.has(kHpdWarn));
  pair.run(air::kSecond);
  CHECK(!pair.a.has(kHpdWarn));  // less than half a period ahead
  CHECK(pair.ether.sent.empty());
  pair.run(9 * air::kSecond);
  CHECK(pair.a.has(kTxFrs));
  CHECK(pair.ether.sent.size() == 1);

  pair.a.send_at(pair.a.time() - 1000);
  CHECK(pair.a.has(kHpdWarn));
  pair.a.control(kOff);
  CHECK(!pair.a.has(kHpdWarn));
  pair.run(20 * air::kSecond);
  CHECK(pair.ether.sent.size() == 1);
  CHECK(pair.a.silent());
}

// UM 3.3: it is the preamble's begin that must not have passed; without time for the transmitter's power
// there is a warning.
void too_little_time_for_the_preamble_is_too_late() {
  Pair pair;
  const auto us = [](double n) { return static_cast<std::uint64_t>(n * 63'897.6); };
  pair.a.send_at(pair.a.time() + us(137.0));
  CHECK(pair.a.has(kHpdWarn));
  pair.a.control(kOff);
  pair.a.send_at(pair.a.time() + us(141.0));
  CHECK(!pair.a.has(kHpdWarn));
  CHECK(pair.a.has(kTxPute));
  pair.run(kMillisecond);
  CHECK(pair.a.has(kTxFrs));
  pair.a.send_at(pair.a.time() + us(151.0));
  CHECK((pair.a.status() & (kHpdWarn | kTxPute)) == 0);
  pair.a.control(kOff);
}

void the_host_may_bring_its_own_fcs() {
  Pair pair;
  pair.b.listen();
  pair.a.prepare(20);
  pair.a.control(kStart | kOwnFcs);
  pair.run(kMillisecond);
  CHECK(pair.b.has(kRxDfr | kRxFce));
  CHECK((pair.b.status() & kRxFcg) == 0);
  CHECK(pair.b.read_bytes(0x11, 0, 20) == pair.ether.sent.at(0).bytes);
  CHECK(pair.ether.sent.at(0).bytes[19] == static_cast<std::uint8_t>(19 * 37 + 11));
}

void after_sending_it_listens_if_asked() {
  Pair pair;
  pair.b.listen();
  pair.a.prepare(12);
  pair.a.control(kStart | kThenListen);
  pair.run(300 * kMicrosecond);
  CHECK(pair.a.has(kTxFrs) && pair.b.has(kRxFcg));
  pair.b.send(12);
  pair.run(300 * kMicrosecond);
  CHECK(pair.a.has(kTxFrs | kRxFcg));  // still told of what it sent

  pair.a.clear();
  pair.a.write(0x1A, 0, 5'000, 4);  // 5.1 ms later
  pair.a.prepare(12);
  pair.a.control(kStart | kThenListen);
  pair.run(kMillisecond);
  pair.b.send(12);
  pair.run(kMillisecond);
  CHECK(!pair.a.has(kRxPrd));
  pair.run(5 * kMillisecond);
  pair.b.send(12);
  pair.run(kMillisecond);
  CHECK(pair.a.has(kRxFcg));
  CHECK(pair.a.silent() && pair.b.silent());
}

void who_sends_does_not_hear() {
  Pair pair;
  pair.a.listen();
  pair.b.send(60);
  pair.run(5 * kMicrosecond);
  pair.a.control(kOff);
  pair.a.send(100);
  pair.run(kMillisecond);
  CHECK(pair.a.has(kTxFrs));
  CHECK((pair.a.status() & (kRxPrd | kRxFcg)) == 0);
  pair.a.listen();
  pair.a.send(12);
  CHECK(pair.a.complained("transmission while the radio is not idle"));
  pair.a.listen();
  CHECK(pair.a.complained("reception while the radio is not idle"));
  pair.a.control(kOff);
  pair.a.send(12);
  pair.run(20 * kMicrosecond);
  pair.a.control(kOff);
  CHECK(pair.a.complained("TRXOFF while a frame is sent"));
}

// On after t microseconds of the preamble, which lasts 130.
bool received_when_turned_on_after(Femto t) {
  Pair pair;
  pair.a.send(12);
  pair.run(10 * kMicrosecond + t);
  pair.b.listen();
  pair.run(kMillisecond);
  return pair.b.has(kRxFcg);
}

void a_receiver_turned_on_late_hears_if_half_of_the_preamble_is_left() {
  CHECK(received_when_turned_on_after(20 * kMicrosecond));
  CHECK(received_when_turned_on_after(45 * kMicrosecond));
  CHECK(!received_when_turned_on_after(55 * kMicrosecond));
  CHECK(!received_when_turned_on_after(200 * kMicrosecond));
}

void a_delayed_receiver_turns_on_at_its_moment() {
  Pair pair;
  pair.b.write(0x0A, 0, pair.b.time() + 2 * kTicksPerMs, 5);
  pair.b.control(kListen | kListenDelayed);
  CHECK(!pair.b.has(kHpdWarn));
  pair.a.send(12);
  pair.run(1'900 * kMicrosecond);
  CHECK(!pair.b.has(kRxPrd));
  pair.run(200 * kMicrosecond);
  pair.a.send(12);
  pair.run(kMillisecond);
  CHECK(pair.b.has(kRxFcg));
  pair.b.write(0x0A, 0, pair.b.time() - 600, 5);
  pair.b.control(kListen | kListenDelayed);
  CHECK(pair.b.has(kHpdWarn));
  pair.b.control(kOff);
  CHECK(pair.b.silent());
}

void other_channels_frequencies_and_codes_are_not_heard() {
  const auto heard = [](std::uint64_t channel_control, std::uint64_t frame_control) {
    Pair pair;
    pair.b.listen();
    pair.a.write(0x1F, 0, channel_control, 4);
    pair.a.prepare(12, frame_control);
    pair.a.control(kStart);
    pair.run(kMillisecond);
    CHECK(pair.ether.sent.size() == 1);
    return pair.b.has(kRxPrd);
  };
  CHECK(heard(0x4A480055, 0x00164000));
  CHECK(!heard(0x4A480022, 0x00164000));  // channel 2
  CHECK(!heard(0x52880055, 0x00164000));  // code 10
  CHECK(!heard(0x21040055, 0x00154000));  // PRF 16, code 4
}

void what_does_not_exist_is_not_sent() {
  Pair pair;
  pair.a.write(0x1F, 0, 0x4A480066, 4);
  pair.a.send(12);
  CHECK(pair.a.complained("does not exist"));
  pair.a.listen();
  CHECK(pair.a.complained("reception on a channel"));
  pair.a.write(0x1F, 0, 0x4A480055, 4);
  pair.a.send(1);
  pair.a.send(128);
  CHECK(pair.a.complained("2 to 127 bytes long, 2 times"));
  pair.run(kMillisecond);
  CHECK(pair.ether.sent.empty());
}

void weak_frames_fade_within_two_decibels_of_the_sensitivity() {
  const auto received = [](double power_dbm) {
    Pair pair;
    pair.ether.rx_power_dbm = power_dbm;
    int count = 0;
    for (int i = 0; i < 400; ++i) {
      pair.b.listen();
      pair.run(50 * kMicrosecond);
      pair.a.send(12);
      pair.run(kMillisecond);
      count += pair.b.has(kRxFcg) ? 1 : 0;
      pair.b.control(kOff);
    }
    return count;
  };
  CHECK(received(-92.9) == 400);
  CHECK_NEAR(received(-94.0), 200, 60);
  CHECK(received(-95.1) == 0);
}

void defaults_that_must_be_changed_cost_sensitivity_and_are_told() {
  Pair pair;
  pair.b.write(0x27, 8, 0x311E0035, 4);
  pair.b.listen();
  CHECK(pair.b.complained("reception with wrong DRX_TUNE2"));
  CHECK(pair.b.chip.complaints().size() == 1);
  pair.ether.rx_power_dbm = -87.0;
  pair.a.send(12);
  pair.run(kMillisecond);
  CHECK(!pair.b.has(kRxPrd));
  pair.ether.rx_power_dbm = -80.0;
  pair.a.send(12);
  pair.run(kMillisecond);
  CHECK(pair.b.has(kRxFcg));

  // A chip straight from its reset.
  air::Events events;
  Air ether(events);
  Host fresh(events, ether);
  fresh.wait(kMillisecond);
  fresh.listen();
  for (const char* name :
       {"AGC_TUNE1", "AGC_TUNE2", "DRX_TUNE2", "NTM", "LDE_CFG2", "FS_PLLTUNE", "LDE_REPC", "microcode"}) {
    CHECK(fresh.complained(name));
  }
  fresh.control(kOff);
  fresh.control(kStart);
  for (const char* name : {"TX_POWER", "RF_TXCTRL", "TC_PGDELAY", "transmission with wrong FS_PLLTUNE"}) {
    CHECK(fresh.complained(name));
  }
}

void without_microcode_frames_come_in_unstamped() {
  Pair pair;
  pair.b.listen();
  pair.a.send(12);
  pair.run(kMillisecond);
  const std::uint64_t stale = pair.b.rx_stamp();
  CHECK(stale != 0);
  pair.b.hz = kSlow;
  pair.b.write(0x36, 0, 0x0301, 2);
  pair.b.write(0x2D, 6, 0x8000, 2);
  pair.b.write(0x36, 0, 0x0200, 2);  // not waited
  pair.b.hz = kFast;
  pair.b.listen();
  pair.a.send(12);
  pair.run(kMillisecond);
  CHECK(pair.b.has(kRxFcg));
  CHECK(!pair.b.has(kLdeDone));
  CHECK(pair.b.rx_stamp() == stale);
}

void nothing_heard_in_time_is_a_timeout() {
  Pair pair;
  pair.b.write(0x04, 0, 0x10001200, 4);
  pair.b.write(0x0C, 0, 1'000, 2);  // 1.0256 ms
  pair.b.listen();
  pair.run(1'025 * kMicrosecond);
  CHECK(!pair.b.has(kRxRfto));
  pair.run(kMicrosecond);
  CHECK(pair.b.status() == kRxRfto);
  pair.a.send(12);
  pair.run(kMillisecond);
  CHECK(pair.b.status() == kRxRfto);  // the receiver is off
  pair.b.listen();
  CHECK(pair.b.status() == 0);
  pair.b.control(kOff);
  pair.run(2 * kMillisecond);
  CHECK(pair.b.status() == 0);
  // It is the whole frame that must be there in time.
  pair.b.listen();
  pair.run(900 * kMicrosecond);
  pair.a.send(12);
  pair.run(kMillisecond);
  CHECK(pair.b.has(kRxPrd | kRxRfto));
  CHECK(!pair.b.has(kRxFcg));
}

void no_preamble_in_time_is_a_timeout_of_its_own() {
  Pair pair;
  pair.b.write(0x27, 0x24, 9, 2);  // 10 chunks of 8 symbols: 81.4 us after the receiver is on
  pair.b.listen();
  pair.run(97 * kMicrosecond);
  CHECK(!pair.b.has(kRxPto));
  pair.run(kMicrosecond);
  CHECK(pair.b.has(kRxPto));
  pair.b.write(0x27, 0x24, 24, 2);
  pair.b.listen();
  pair.run(20 * kMicrosecond);
  pair.a.send(127);
  pair.run(kMillisecond);
  CHECK(pair.b.has(kRxFcg));
}

void a_receiver_of_110_kbps_waits_in_vain_for_the_sfd_of_6800() {
  Pair pair;
  pair.ether.rx_power_dbm = -40.0;  // its tuning stays that of 6.8 Mb/s
  pair.b.write(0x04, 0, 0x00401200, 4);
  pair.b.write(0x27, 0x20, 100, 2);
  pair.b.listen();
  pair.a.send(12);
  pair.run(220 * kMicrosecond);
  CHECK(pair.b.has(kRxPrd));
  CHECK(!pair.b.has(kRxSfdto));
  pair.run(50 * kMicrosecond);
  CHECK(pair.b.has(kRxSfdto));
}

void slow_rates_work_too() {
  const auto works = [](std::uint64_t kind, std::uint64_t config, Femto airtime) {
    Pair pair;
    pair.ether.rx_power_dbm = -40.0;
    pair.b.write(0x04, 0, config, 4);
    pair.b.listen();
    pair.a.prepare(30, kind);
    pair.a.control(kStart);
    pair.run(airtime + 12 * kMicrosecond);
    return pair.b.has(kRxFcg);
  };
  CHECK(works(0x000A0000, 0x00401200, 3'643 * kMicrosecond));  // 110 kb/s, 1024 symbols
  CHECK(works(0x00162000, 0x00001200, 456 * kMicrosecond));    // 850 kb/s, 128 symbols: 159.9 + 295.4 us
}

// Three chips: two that send, with powers of their own at the third.
struct Collision {
  Collision() : ether(events), third(events, ether) {
    third.configure();
    arrival.emission.bytes.assign(60, 0);
    arrival.emission.channel = 5;
    arrival.emission.prf_mhz = 64;
    arrival.emission.preamble_code = 9;
    third.listen();
    third.wait(kMillisecond);
  }
  // Their times are those of 60 bytes: 138.4 us before the marker, 95.4 after it.
  void arrives(Femto after, double power_dbm) {
    arrival.emission.begin = begin + after;
    arrival.emission.marker = begin + after + 138'398 * kMicrosecond / 1000;
    arrival.emission.end = begin + after + 233'800 * kMicrosecond / 1000;
    arrival.rx_power_dbm = arrival.fp_power_dbm = power_dbm;
    events.at(begin + after, [this, heard = arrival] { third.chip.hear(heard); });
  }
  std::uint64_t outcome() {
    events.run_until(begin + kMillisecond);
    return third.status() & (kRxPhe | kRxRfsl | kRxFce | kRxFcg | kRxDfr);
  }

  air::Events events;
  Air ether;
  Host third;
  air::Arrival arrival;  // 60 zeros have the FCS zero
  Femto begin = 3 * kMillisecond;
};

void collisions_break_what_is_being_received() {
  struct Case {
    Femto after_us;
    double power_dbm;
    std::uint64_t outcome;
  };
  constexpr std::uint64_t good = kRxDfr | kRxFcg;
  for (const Case& one : {Case{100, -80.0, kRxPhe}, Case{145, -85.9, kRxPhe}, Case{170, -80.0, kRxRfsl},
                          Case{232, -80.0, kRxDfr | kRxFce}, Case{234, -80.0, good},
                          // weaker by more than 6 dB; stronger by much
                          Case{100, -86.1, good}, Case{170, -86.1, good}, Case{170, -60.0, kRxRfsl},
                          Case{100, -60.0, kRxPhe}}) {
    Collision collision;
    collision.arrives(0, -80.0);
    collision.arrives(one.after_us * kMicrosecond, one.power_dbm);
    CHECK(collision.outcome() == one.outcome);
  }
  // Those that begin together spoil each other: one that comes before the first is found, and is about as
  // strong.
  for (const Femto after_us : {5, 60}) {
    for (const double power_dbm : {-85.0, -80.0, -75.0}) {
      Collision together;
      together.arrives(0, -80.0);
      together.arrives(after_us * kMicrosecond, power_dbm);
      CHECK(together.outcome() == kRxPhe);
    }
  }
  // One that comes before the first is found, and drowns it, is received itself.
  Collision drowned;
  drowned.arrives(0, -80.0);
  drowned.arrives(30 * kMicrosecond, -60.0);
  CHECK(drowned.outcome() == good);
  // What is on another channel does not disturb.
  Collision apart;
  apart.arrives(0, -80.0);
  apart.arrival.emission.channel = 2;
  apart.arrives(170 * kMicrosecond, -80.0);
  CHECK(apart.outcome() == good);
}

void what_comes_in_unnoticed_disturbs_all_the_same() {
  Collision alone;
  alone.arrival.unnoticed = true;
  alone.arrives(0, -80.0);
  CHECK(alone.outcome() == 0 && !alone.third.has(kRxPrd));
  Collision collision;
  collision.arrives(0, -80.0);
  collision.arrival.unnoticed = true;
  collision.arrives(100 * kMicrosecond, -80.0);
  CHECK(collision.outcome() == kRxPhe);
}

void a_frame_in_whose_middle_it_turned_on_hides_the_next() {
  Collision collision;
  collision.third.control(kOff);
  collision.arrives(0, -80.0);
  collision.arrives(200 * kMicrosecond, -80.0);  // the first ends 34 us into it
  collision.arrives(600 * kMicrosecond, -80.0);
  collision.arrives(700 * kMicrosecond, -80.0);  // the one before ends after its preamble
  collision.events.run_until(collision.begin + 150 * kMicrosecond);
  collision.third.listen();
  collision.events.run_until(collision.begin + 500 * kMicrosecond);
  CHECK(collision.third.has(kGood));
  CHECK(collision.third.read(0x10, 0, 4) >> 20U ==
        128 - 33);  // symbols that it heard of the second's preamble
  collision.events.run_until(collision.begin + 720 * kMicrosecond);
  collision.third.listen();
  collision.third.wait(kMillisecond);
  CHECK(collision.third.status() == 0);
}

// Receives one frame; by how much its stamp is wrong, in ticks.
std::int64_t stamp_error(Collision& collision) {
  collision.third.listen();
  collision.begin = collision.events.now() + 100 * kMicrosecond;
  collision.arrives(0, -80.0);
  collision.third.wait(kMillisecond);
  CHECK(collision.third.has(kGood));
  const Femto marker = collision.begin + 138'398 * kMicrosecond / 1000;
  return difference(collision.third.rx_stamp(),
                    static_cast<std::uint64_t>(std::llround(air::to_seconds(marker) * 63.8976e9)));
}

void after_an_error_the_next_stamp_is_wrong_unless_the_receiver_was_reset() {
  const auto break_one = [](Collision& collision, Femto after) {
    collision.arrives(0, -80.0);
    collision.arrives(after, -80.0);
    CHECK((collision.outcome() & kRxFcg) == 0);
  };
  const auto time_out = [](Collision& collision) {
    collision.third.control(kOff);
    collision.third.write(0x04, 0, 0x10001200, 4);
    collision.third.write(0x0C, 0, 10, 2);
    collision.third.listen();
    collision.third.wait(kMillisecond);
    CHECK(collision.third.has(kRxRfto));
    collision.third.write(0x04, 0, 0x00001200, 4);
  };
  for (int kind = 0; kind < 3; ++kind) {
    for (const bool reset : {false, true}) {
      Collision collision;
      if (kind == 0) break_one(collision, 100 * kMicrosecond);  // RXPHE
      if (kind == 1) break_one(collision, 170 * kMicrosecond);  // RXRFSL
      if (kind == 2) time_out(collision);
      if (reset) collision.third.reset_receiver();
      const double error_ns = static_cast<double>(std::abs(stamp_error(collision))) / 63.8976;
      CHECK(reset ? error_ns < 0.05 : error_ns > 20.0 && error_ns < 60.0);
      CHECK(std::abs(stamp_error(collision)) <= 2);  // the one after is right again
    }
  }
  Collision bad_fcs;
  break_one(bad_fcs, 232 * kMicrosecond);
  CHECK(std::abs(stamp_error(bad_fcs)) <= 2);
}

void the_formulas_of_the_manual_give_back_the_powers() {
  for (const double rx_dbm : {-90.0, -80.0, -70.0}) {
    Pair pair;
    pair.ether.rx_power_dbm = rx_dbm;
    pair.ether.fp_power_dbm = rx_dbm - 4.0;
    pair.b.listen();
    pair.run(kMillisecond);
    pair.a.send(12);
    pair.run(kMillisecond);
    CHECK(pair.b.has(kGood));
    const auto n = static_cast<double>(pair.b.read(0x10, 0, 4) >> 20U);
    CHECK_NEAR(n, 128, 0);
    const auto f1 = static_cast<double>(pair.b.read(0x15, 7, 2)),
               f2 = static_cast<double>(pair.b.read(0x12, 2, 2)),
               f3 = static_cast<double>(pair.b.read(0x12, 4, 2)),
               c = static_cast<double>(pair.b.read(0x12, 6, 2));
    CHECK_NEAR(10 * std::log10((f1 * f1 + f2 * f2 + f3 * f3) / (n * n)) - 121.74, rx_dbm - 4.0, 0.05);
    CHECK_NEAR(10 * std::log10(c * 131'072 / (n * n)) - 121.74, rx_dbm, 0.05);
  }
  Pair near;
  near.ether.rx_power_dbm = near.ether.fp_power_dbm = -30.0;
  near.b.listen();
  near.a.send(12);
  near.run(kMillisecond);
  CHECK(near.b.read(0x12, 6, 2) == 0xFFFF && near.b.read(0x15, 7, 2) == 0xFFFF);
}

void the_clock_offset_is_above_zero_where_the_sender_is_faster() {
  air::Chip::Nature fast, slow;
  fast.ppm = 12.0;
  slow.ppm = -5.0;
  Pair pair(fast, slow);
  const auto ppm = [](Host& host) {
    auto offset = static_cast<std::int64_t>(host.read(0x14, 0, 3) & 0x7FFFFU);
    if (offset >= 0x40000) offset -= 0x80000;
    CHECK(host.read(0x13, 0, 4) == 0x01FC0000);
    return 1e6 * static_cast<double>(offset) / 0x01FC0000;
  };
  pair.b.listen();
  pair.a.send(12);
  pair.run(kMillisecond);
  CHECK_NEAR(ppm(pair.b), 17.0, 0.02);
  pair.a.listen();
  pair.b.send(12);
  pair.run(kMillisecond);
  CHECK_NEAR(ppm(pair.a), -17.0, 0.02);
}

void nothing_is_on_the_air_before_the_pll_locks_or_asleep() {
  air::Events events;
  Air ether(events);
  Host host(events, ether);
  host.hz = kSlow;
  host.send(12);
  CHECK(host.complained("transmission before the PLL has locked"));
  host.wait(kMillisecond);
  CHECK(ether.sent.empty());
  host.write(0x36, 0, 0x0201, 2);
  host.listen();
  CHECK(host.complained("clock forced to the crystal"));
}

void the_same_seed_tells_the_same_story() {
  const auto story = [](std::uint64_t seed) {
    air::Chip::Nature nature;
    nature.seed = seed;
    Pair pair({}, nature);
    pair.ether.rx_power_dbm = -94.0;
    std::vector<bool> heard;
    for (int i = 0; i < 64; ++i) {
      pair.b.listen();
      pair.a.send(12);
      pair.run(kMillisecond);
      heard.push_back(pair.b.has(kRxFcg));
      pair.b.control(kOff);
    }
    return heard;
  };
  const std::vector<bool> once = story(3), again = story(3), other = story(4);
  CHECK(once == again);
  CHECK(once != other);
}

}  // namespace

int main() {
  the_fcs_is_that_of_802_15_4();
  airtimes_are_those_of_the_standard();
  sending_tells_its_progress_and_takes_the_airtime();
  a_frame_comes_in_with_its_events_in_order_and_the_receiver_is_off_afterwards();
  the_time_of_flight_comes_out_of_the_stamps();
  the_receivers_stamp_is_its_counter_less_its_antenna_delay_and_wraps();
  transmit_stamps_know_the_register_not_the_antenna();
  a_moment_that_has_passed_is_warned_of_and_nothing_sent_for_a_period();
  too_little_time_for_the_preamble_is_too_late();
  the_host_may_bring_its_own_fcs();
  after_sending_it_listens_if_asked();
  who_sends_does_not_hear();
  a_receiver_turned_on_late_hears_if_half_of_the_preamble_is_left();
  a_delayed_receiver_turns_on_at_its_moment();
  other_channels_frequencies_and_codes_are_not_heard();
  what_does_not_exist_is_not_sent();
  weak_frames_fade_within_two_decibels_of_the_sensitivity();
  defaults_that_must_be_changed_cost_sensitivity_and_are_told();
  without_microcode_frames_come_in_unstamped();
  nothing_heard_in_time_is_a_timeout();
  no_preamble_in_time_is_a_timeout_of_its_own();
  a_receiver_of_110_kbps_waits_in_vain_for_the_sfd_of_6800();
  slow_rates_work_too();
  collisions_break_what_is_being_received();
  what_comes_in_unnoticed_disturbs_all_the_same();
  a_frame_in_whose_middle_it_turned_on_hides_the_next();
  after_an_error_the_next_stamp_is_wrong_unless_the_receiver_was_reset();
  the_formulas_of_the_manual_give_back_the_powers();
  the_clock_offset_is_above_zero_where_the_sender_is_faster();
  nothing_is_on_the_air_before_the_pll_locks_or_asleep();
  the_same_seed_tells_the_same_story();
  return check::verdict();
}
