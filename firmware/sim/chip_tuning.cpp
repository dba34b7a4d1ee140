#include "firmware/sim/chip_tuning.h"

#include <array>
#include <cstdint>

namespace air {

namespace {

struct Channel {
  int number;
  std::uint32_t rf_txctrl, fs_pllcfg;
  std::uint8_t rf_rxctrlh, tc_pgdelay, fs_plltune;
};

// UM tables 37, 38, 40, 43, 44.
constexpr std::array<Channel, 6> kChannels = {{
    {1, 0x00005C40, 0x09000407, 0xD8, 0xC9, 0x1E},
    {2, 0x00045CA0, 0x08400508, 0xD8, 0xC2, 0x26},
    {3, 0x00086CC0, 0x08401009, 0xD8, 0xC5, 0x56},
    {4, 0x00045C80, 0x08400508, 0xBC, 0x95, 0x26},
    {5, 0x001E3FE0, 0x0800041D, 0xD8, 0xC0, 0xBE},
    {7, 0x001E7DE0, 0x0800041D, 0xBC, 0x93, 0xBE},
}};

// UM table 51, by preamble code from 1; an eighth of it at 110 kb/s.
constexpr std::array<std::uint16_t, 24> kLdeRepc = {
    0x5998, 0x5998, 0x51EA, 0x428E, 0x451E, 0x2E14, 0x8000, 0x51EA, 0x28F4, 0x3332, 0x3AE0, 0x3D70,
    0x3AE0, 0x35C2, 0x2B84, 0x35C2, 0x3332, 0x35C2, 0x35C2, 0x47AE, 0x3AE0, 0x3850, 0x30A2, 0x3850};

// UM table 33: by pulse repetition frequency and size of the preamble's chunks (8, 16, 32, 64).
constexpr std::array<std::uint32_t, 4> kDrxTune2Prf16 = {0x311A002D, 0x331A0052, 0x351A009A, 0x371A011D};
constexpr std::array<std::uint32_t, 4> kDrxTune2Prf64 = {0x313B006B, 0x333B00BE, 0x353B015E, 0x373B0296};

constexpr std::uint32_t kUntouchedTxPower = 0x1E080222;

const Channel* channel_of(int number) {
  for (const Channel& channel : kChannels) {
    if (channel.number == number) return &channel;
  }
  return nullptr;
}

int bits(std::uint64_t value, unsigned from, unsigned count) {
  return static_cast<int>(value >> from & ((1U << count) - 1U));
}

int prf_of(int code) { return code == 1 ? 16 : code == 2 ? 64 : 0; }

// UM table 16.
int preamble_of(int psr, int extension) {
  constexpr std::array<std::array<int, 4>, 4> kSymbols = {
      {{0, 0, 0, 0}, {64, 128, 256, 512}, {1024, 1536, 2048, 0}, {4096, 0, 0, 0}}};
  return kSymbols[static_cast<std::size_t>(psr)][static_cast<std::size_t>(extension)];
}

class Check {
 public:
  Check(const Registers& registers, const Wrong& wrong) : registers_(registers), wrong_(wrong) {}

  void that(bool right, const char* name) {
    if (right) return;
    ++count_;
    wrong_(name);
  }
  void is(const Register& where, std::uint64_t value, const char* name) {
    that(registers_.get(where) == value, name);
  }
  int count() const { return count_; }

 private:
  const Registers& registers_;
  const Wrong& wrong_;
  int count_ = 0;
};

void check_synthesiser(Check& check, const Channel& channel) {
  check.is(reg::kFsPllCfg, channel.fs_pllcfg, "FS_PLLCFG");
  check.is(reg::kFsPllTune, channel.fs_plltune, "FS_PLLTUNE");
}

}  // namespace

Tuned transmitter_of(const Registers& registers) {
  const std::uint64_t control = registers.get(reg::kChanCtrl);
  const std::uint64_t frame = registers.get(reg::kTxFctrl);
  constexpr std::array kKbps = {110, 850, 6800, 0};
  Tuned found;
  found.channel = bits(control, 0, 4);
  found.preamble_code = bits(control, 22, 5);
  found.phy.kbps = kKbps[static_cast<std::size_t>(bits(frame, 13, 2))];
  found.phy.prf_mhz = prf_of(bits(frame, 16, 2));
  found.phy.preamble_symbols = preamble_of(bits(frame, 18, 2), bits(frame, 20, 2));
  return found;
}

Tuned receiver_of(const Registers& registers) {
  const std::uint64_t control = registers.get(reg::kChanCtrl);
  constexpr std::uint64_t kRxm110k = 0x00400000;
  Tuned found;
  found.channel = bits(control, 4, 4);
  found.preamble_code = bits(control, 27, 5);
  found.phy.kbps = (registers.get(reg::kSysCfg) & kRxm110k) != 0 ? 110 : 6800;
  found.phy.prf_mhz = prf_of(bits(control, 18, 2));
  found.phy.preamble_symbols = transmitter_of(registers).phy.preamble_symbols;
  return found;
}

bool possible(const Tuned& tuned) {
  if (channel_of(tuned.channel) == nullptr || tuned.phy.kbps == 0 || tuned.phy.preamble_symbols == 0)
    return false;
  if (tuned.phy.prf_mhz == 16) return tuned.preamble_code >= 1 && tuned.preamble_code <= 8;
  return tuned.phy.prf_mhz == 64 && tuned.preamble_code >= 9 && tuned.preamble_code <= 24;
}

int wrong_of_transmitter(const Registers& registers, const Wrong& wrong) {
  const Tuned tuned = transmitter_of(registers);
  const Channel* channel = channel_of(tuned.channel);
  if (channel == nullptr) return 0;
  Check check(registers, wrong);
  check_synthesiser(check, *channel);
  check.is(reg::kRfTxCtrl, channel->rf_txctrl, "RF_TXCTRL");
  check.is(reg::kTcPgDelay, channel->tc_pgdelay, "TC_PGDELAY");
  check.that(registers.get(reg::kTxPower) != kUntouchedTxPower, "TX_POWER");
  return check.count();
}

int wrong_of_receiver(const Registers& registers, const Wrong& wrong) {
  const Tuned tuned = receiver_of(registers);
  const Channel* channel = channel_of(tuned.channel);
  if (channel == nullptr || !possible(tuned)) return 0;
  const bool prf16 = tuned.phy.prf_mhz == 16, slow = tuned.phy.kbps == 110;
  Check check(registers, wrong);
  check_synthesiser(check, *channel);
  check.is(reg::kRfRxCtrlH, channel->rf_rxctrlh, "RF_RXCTRLH");
  check.is(reg::kAgcTune1, prf16 ? 0x8870 : 0x889B, "AGC_TUNE1");
  check.is(reg::kAgcTune2, 0x2502A907, "AGC_TUNE2");
  check.is(reg::kDrxTune0b, slow ? 0x000A : 0x0001, "DRX_TUNE0b");
  check.is(reg::kDrxTune1a, prf16 ? 0x0087 : 0x008D, "DRX_TUNE1a");
  check.is(reg::kDrxTune1b, slow ? 0x0064 : tuned.phy.preamble_symbols == 64 ? 0x0010 : 0x0020, "DRX_TUNE1b");
  check.is(reg::kDrxTune4h, tuned.phy.preamble_symbols == 64 ? 0x0010 : 0x0028, "DRX_TUNE4H");
  const auto& chunks = prf16 ? kDrxTune2Prf16 : kDrxTune2Prf64;
  const std::uint64_t tune2 = registers.get(reg::kDrxTune2);
  check.that(tune2 == chunks[0] || tune2 == chunks[1] || tune2 == chunks[2] || tune2 == chunks[3],
             "DRX_TUNE2");
  check.that(bits(registers.get(reg::kLdeCfg1), 0, 5) == 13, "LDE_CFG1 (NTM)");
  check.is(reg::kLdeCfg2, prf16 ? 0x1607 : 0x0607, "LDE_CFG2");
  const std::uint64_t repc = kLdeRepc[static_cast<std::size_t>(tuned.preamble_code) - 1];
  check.is(reg::kLdeRepc, slow ? repc / 8 : repc, "LDE_REPC");
  return check.count();
}

int preamble_chunk(const Registers& registers) { return 8 << bits(registers.get(reg::kDrxTune2), 25, 2); }

}  // namespace air
