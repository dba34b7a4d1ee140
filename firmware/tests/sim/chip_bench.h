// A DW1000 model on the bench: raw SPI transactions, and an air that carries everything to everybody after
// the same time.
#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include "firmware/sim/chip.h"
#include "firmware/sim/events.h"

namespace bench {

using air::Femto;
using air::kMicrosecond;
using air::kMillisecond;

constexpr std::uint64_t kWrap = std::uint64_t{1} << 40U;
constexpr double kSlow = 3e6, kFast = 20e6;

// Bits of SYS_STATUS.
constexpr std::uint64_t kIrqs = 1, kCpLock = 1 << 1, kTxFrb = 1 << 4, kTxPrs = 1 << 5, kTxPhs = 1 << 6,
                        kTxFrs = 1 << 7;
constexpr std::uint64_t kRxPrd = 1 << 8, kRxSfdd = 1 << 9, kLdeDone = 1 << 10, kRxPhd = 1 << 11,
                        kRxPhe = 1 << 12;
constexpr std::uint64_t kRxDfr = 1 << 13, kRxFcg = 1 << 14, kRxFce = 1 << 15, kRxRfsl = 1 << 16,
                        kRxRfto = 1 << 17;
constexpr std::uint64_t kRxPto = 1 << 21, kSlp2Init = 1 << 23, kRxSfdto = 1 << 26, kHpdWarn = 1 << 27;
constexpr std::uint64_t kTxPute = std::uint64_t{1} << 34U;
constexpr std::uint64_t kGood = kRxPrd | kRxSfdd | kLdeDone | kRxPhd | kRxDfr | kRxFcg;

// Commands of SYS_CTRL.
constexpr std::uint64_t kOwnFcs = 0x01, kStart = 0x02, kDelayed = 0x04, kOff = 0x40, kThenListen = 0x80,
                        kListen = 0x100;
constexpr std::uint64_t kListenDelayed = 0x200;

class Air : public air::Ether {
 public:
  explicit Air(air::Events& events) : events_(events) {}

  void send(air::Chip& from, const air::Emission& emission) override {
    sent.push_back(emission);
    for (air::Chip* chip : chips) {
      if (chip == &from) continue;
      air::Arrival arrival;
      arrival.emission = emission;
      arrival.emission.begin += flight;
      arrival.emission.marker += flight;
      arrival.emission.end += flight;
      arrival.rx_power_dbm = rx_power_dbm;
      arrival.fp_power_dbm = fp_power_dbm;
      arrival.stamp_error = stamp_error;
      events_.at(events_.now() + flight, [chip, arrival] { chip->hear(arrival); });
    }
  }

  std::vector<air::Chip*> chips;
  std::vector<air::Emission> sent;
  Femto flight = 33'356'410;  // of 10 m
  Femto stamp_error = 0;
  double rx_power_dbm = -80.0, fp_power_dbm = -82.0;

 private:
  air::Events& events_;
};

// One host and its chip.
class Host {
 public:
  Host(air::Events& time, Air& ether, const air::Chip::Nature& nature = {})
      : events(time), chip(time, ether, nature) {
    ether.chips.push_back(&chip);
  }

  // UM 2.2.1.2: one octet of header without an index, two up to 127, three beyond.
  std::vector<std::uint8_t> header(bool writes, unsigned file, unsigned index) const {
    std::vector<std::uint8_t> bytes{
        static_cast<std::uint8_t>((writes ? 0x80U : 0U) | (index > 0 ? 0x40U : 0U) | file)};
    if (index > 127) {
      bytes.push_back(static_cast<std::uint8_t>(0x80U | (index & 0x7FU)));
      bytes.push_back(static_cast<std::uint8_t>(index >> 7U));
    } else if (index > 0) {
      bytes.push_back(static_cast<std::uint8_t>(index));
    }
    return bytes;
  }
  void write_bytes(unsigned file, unsigned index, std::vector<std::uint8_t> data) {
    const auto head = header(true, file, index);
    chip.spi(head.data(), head.size(), data.data(), data.size(), hz);
  }
  void write(unsigned file, unsigned index, std::uint64_t value, std::size_t size) {
    std::vector<std::uint8_t> data(size);
    for (std::uint8_t& byte : data) {
      byte = static_cast<std::uint8_t>(value);
      value >>= 8U;
    }
    write_bytes(file, index, data);
  }
  std::vector<std::uint8_t> read_bytes(unsigned file, unsigned index, std::size_t size) {
    std::vector<std::uint8_t> data(size, 0xA5);
    const auto head = header(false, file, index);
    chip.spi(head.data(), head.size(), data.data(), data.size(), hz);
    return data;
  }
  std::uint64_t read(unsigned file, unsigned index, std::size_t size) {
    std::uint64_t value = 0;
    const auto data = read_bytes(file, index, size);
    for (std::size_t i = size; i-- > 0;) value = value << 8U | data[i];
    return value;
  }

  void wait(Femto time) { events.run_until(events.now() + time); }
  std::uint64_t status() { return read(0x0F, 0, 5); }
  bool has(std::uint64_t bits) { return (status() & bits) == bits; }
  void clear() { write(0x0F, 0, 0xFFFFFFFFFF, 5); }
  void control(std::uint64_t bits) { write(0x0D, 0, bits, 4); }
  std::uint64_t time() { return read(0x06, 0, 5); }
  std::uint64_t rx_stamp() { return read(0x15, 0, 5); }
  std::uint64_t tx_stamp() { return read(0x17, 0, 5); }
  void reset_receiver() {
    write(0x36, 3, 0xE0, 1);
    write(0x36, 3, 0xF0, 1);
  }

  void load_microcode() {
    hz = kSlow;
    write(0x36, 0, 0x0301, 2);
    write(0x2D, 6, 0x8000, 2);
    wait(150 * kMicrosecond);
    write(0x36, 0, 0x0200, 2);
    hz = kFast;
  }
  void load_ldo_tune() {
    if (read_otp(4) != 0) write(0x2D, 0x12, 0x02, 1);
  }
  // UM 6.3.3, with the crystal as system clock.
  std::uint64_t read_otp(unsigned address) {
    hz = kSlow;
    write(0x36, 0, 0x01, 1);
    write(0x2D, 4, address, 2);
    write(0x2D, 6, 0x03, 1);
    write(0x2D, 6, 0x00, 1);
    const std::uint64_t word = read(0x2D, 0x0A, 4);
    write(0x36, 0, 0x00, 1);
    hz = kFast;
    return word;
  }

  // Channel 5, PRF 64 MHz, code 9, 6.8 Mb/s, preamble of 128 symbols: all that UM 2.5.5 and the tables ask
  // for.
  void configure() {
    hz = kSlow;
    wait(kMillisecond);
    load_microcode();
    load_ldo_tune();
    write(0x1F, 0, 0x4A480055, 4);
    write(0x1E, 0, 0x85858585, 4);
    write(0x23, 0x04, 0x889B, 2);
    write(0x23, 0x0C, 0x2502A907, 4);
    write(0x27, 0x02, 0x0001, 2);
    write(0x27, 0x04, 0x008D, 2);
    write(0x27, 0x06, 0x0020, 2);
    write(0x27, 0x08, 0x313B006B, 4);
    write(0x27, 0x26, 0x0028, 2);
    write(0x28, 0x0B, 0xD8, 1);
    write(0x28, 0x0C, 0x001E3FE0, 4);
    write(0x2A, 0x0B, 0xC0, 1);
    write(0x2B, 0x07, 0x0800041D, 4);
    write(0x2B, 0x0B, 0xBE, 1);
    write(0x2E, 0x0806, 0x6D, 1);
    write(0x2E, 0x1806, 0x0607, 2);
    write(0x2E, 0x2804, 0x28F4, 2);
    clear();
  }
  // `size` with the FCS.
  void prepare(std::size_t size, std::uint64_t kind = 0x00164000) {
    std::vector<std::uint8_t> data(size);
    for (std::size_t i = 0; i < size; ++i) data[i] = static_cast<std::uint8_t>(i * 37U + 11U);
    write_bytes(0x09, 0, data);
    write(0x08, 0, kind | size, 5);
  }
  void send(std::size_t size = 12) {
    prepare(size);
    control(kStart);
  }
  void send_at(std::uint64_t ticks, std::size_t size = 12, std::uint64_t also = 0) {
    prepare(size);
    write(0x0A, 0, ticks, 5);
    control(kStart | kDelayed | also);
  }
  void listen() { control(kListen); }

  bool complained(const std::string& what) const {
    return std::any_of(chip.complaints().begin(), chip.complaints().end(),
                       [&](const std::string& c) { return c.find(what) != std::string::npos; });
  }
  bool silent() const { return chip.complaints().empty(); }

  air::Events& events;
  air::Chip chip;
  double hz = kFast;
};

// Two of them, configured.
struct Pair {
  explicit Pair(const air::Chip::Nature& a_nature = {}, const air::Chip::Nature& b_nature = {})
      : ether(events), a(events, ether, a_nature), b(events, ether, b_nature) {
    a.configure();
    b.configure();
  }
  void run(Femto time) { events.run_until(events.now() + time); }

  air::Events events;
  Air ether;
  Host a, b;
};

}  // namespace bench
