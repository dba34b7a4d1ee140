#include "firmware/sim/chip.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "firmware/sim/chip_bits.h"

namespace air {

namespace {

constexpr double kSlowHz = 3e6, kFastHz = 20e6;       // UM 2.3.2, DS
constexpr Femto kLockTime = 35 * kMicrosecond;        // of the PLL
constexpr Femto kWakeTime = 500 * kMicrosecond;       // chip select is low so long to wake it (UM 2.4.1.1)
constexpr Femto kCrystalTime = 3 * kMillisecond;      // until the crystal swings
constexpr Femto kMicrocodeTime = 150 * kMicrosecond;  // UM table 4
constexpr std::uint8_t kNobody = 0xFF;                // read where nobody answers
constexpr double kDegreesPerStep = 1.14;              // UM 6.4

// Addresses in the OTP (UM 6.3.1).
constexpr std::uint64_t kOtpLdoTune = 0x04, kOtpVoltage = 0x08, kOtpTemperature = 0x09,
                        kOtpCrystalTrim = 0x1E;

std::string in_file(const char* what, std::uint8_t file) {
  constexpr const char* kDigits = "0123456789ABCDEF";
  return std::string(what) + " of register file 0x" + kDigits[file >> 4U] + kDigits[file & 0xFU];
}

}  // namespace

Chip::Chip(Events& events, Ether& ether, const Nature& nature)
    : events_(events),
      ether_(ether),
      nature_(nature),
      random_{nature.seed},
      crystal_(static_cast<double>(kTickHz), nature.ppm, events.now()) {
  // What the factory found; one chip in eight has no tuning of its LDOs.
  if (random_.next() % 8 != 0)
    otp_ldo_tune_ = 0x28282828U + static_cast<std::uint32_t>(random_.next() & 0x07070707U);
  otp_temperature_ = static_cast<std::uint8_t>(130 + random_.next() % 20);
  otp_voltage_ = static_cast<std::uint8_t>(170 + random_.next() % 10);
  otp_crystal_trim_ = static_cast<std::uint8_t>(0x0D + random_.next() % 6);
  begin();
}

// --- Power ---

void Chip::forget() {
  stop_radio();
  ++power_epoch_;
  air_.clear();
  status_ = 0;
  microcode_ = microcode_loading_ = false;
  needs_reset_ = false;
}

void Chip::forget_all() {
  saved_.reset();
  registers_.reset();
  aon_wake_ = aon_sleep_ = 0;
}

// With power, after a reset and after sleep: as the always-on block says, which forgets only without power.
void Chip::begin() {
  forget();
  const Registers before = registers_;
  registers_.reset();
  registers_.copy(reg::kAon, before);
  if ((aon_wake_ & aon::kLoadConfiguration) != 0) registers_.restore(saved_);
  if ((aon_wake_ & aon::kLoadLdoTune) != 0) registers_.set(reg::kLdoTune, otp_ldo_tune_);
  if ((aon_wake_ & aon::kMeasure) != 0) {
    registers_.set(reg::kSarWtemp, temperature_reading());
    registers_.set(reg::kSarWvbat, otp_voltage_);
  }
  microcode_ = (aon_wake_ & aon::kLoadMicrocode) != 0;
  crystal_ = Crystal(static_cast<double>(kTickHz), crystal_.ppm(), events_.now());
  power_ = Power::kInit;
  power_at<&Chip::lock>(events_.now() + kLockTime);
  set_status(status::kSlp2Init);
}

void Chip::lock() {
  power_ = Power::kOn;
  set_status(status::kCpLock);
}

// A sleeper holds RSTn low itself and does not notice (DS).
void Chip::reset() {
  if (power_ == Power::kInit || power_ == Power::kOn) begin();
}

void Chip::power(bool on) {
  if (on == (power_ != Power::kOff)) return;
  if (on) {
    begin();
    return;
  }
  forget();
  forget_all();
  power_ = Power::kOff;
  update_line();
}

void Chip::fall_asleep() {
  if (radio_ != Radio::kIdle) complain("sleep while the radio is not idle");
  if ((registers_.get(reg::kAonCfg1) & (aon::kSleepCounter | aon::kSmxx)) != 0) {
    complain("sleep with AON_CFG1 not cleared");
  }
  if ((aon_sleep_ & aon::kWakeBySpi) == 0) complain("sleep from which chip select does not wake");
  forget();
  power_ = Power::kAsleep;
  update_line();
}

void Chip::select_for(Femto time) {
  if (power_ != Power::kAsleep || time < kWakeTime || (aon_sleep_ & aon::kWakeBySpi) == 0) return;
  power_ = Power::kWaking;
  power_at<&Chip::begin>(std::max(events_.now(), events_.now() - time + kWakeTime + kCrystalTime));
}

// --- The host's side ---

bool Chip::crystal_clock() const {
  return power_ != Power::kOn ||
         (registers_.get(reg::kPmscCtrl0) & pmsc::kSysClocks) == pmsc::kSysClockCrystal;
}

void Chip::spi(const std::uint8_t* header, std::size_t header_size, std::uint8_t* data, std::size_t size,
               double hz) {
  const std::optional<SpiHeader> decoded = decode_header(header, header_size);
  if (!decoded) complain("a header that is not as long as it says");
  const bool writes = decoded && decoded->write;
  if (!decoded || power_ == Power::kOff || power_ == Power::kAsleep || power_ == Power::kWaking) {
    if (writes && power_ != Power::kOff) complain("a write while asleep");
    if (!writes) std::fill_n(data, size, kNobody);
    select_for(seconds(8.0 * static_cast<double>(header_size + size) / hz));
    return;
  }
  const bool too_fast = hz > (crystal_clock() ? kSlowHz : kFastHz);
  if (too_fast)
    complain(crystal_clock() ? "SPI faster than 3 MHz before the PLL drives the chip"
                             : "SPI faster than 20 MHz");
  if (Registers::size(decoded->file) == 0) {
    complain(in_file(writes ? "write" : "read", decoded->file) + ", which is undocumented");
    if (!writes) std::fill_n(data, size, std::uint8_t{0});
    return;
  }
  if (writes) {
    write(*decoded, data, size, too_fast);
    return;
  }
  read(*decoded, data, size);
  if (too_fast)
    std::transform(data, data + size, data, [this](std::uint8_t byte) { return corrupted(byte); });
}

// One byte in two loses a bit or two.
std::uint8_t Chip::corrupted(std::uint8_t byte) {
  const std::uint64_t dice = random_.next();
  if ((dice & 1U) == 0) return byte;
  return static_cast<std::uint8_t>(byte ^ (1U << (dice >> 1U & 7U)) ^ (dice >> 4U & 1U) << (dice >> 5U & 7U));
}

void Chip::read(const SpiHeader& header, std::uint8_t* data, std::size_t size) {
  if (header.file == reg::kSysTime.file)
    registers_.set(reg::kSysTime, counter() & ~kSystemTick & kCounterMask);
  if (header.file == reg::kSysStatus.file) {
    const bool pending = (status_ & registers_.get(reg::kSysMask) & status::kMaskable) != 0;
    registers_.set(reg::kSysStatus, status_ | (pending ? status::kIrqs : 0));
  }
  if (header.file == reg::kTxBuffer.file) complain("read of TX_BUFFER, which can only be written");
  const std::size_t all = Registers::size(header.file);
  const std::size_t begin = std::min<std::size_t>(header.index, all);
  const std::size_t count = std::min(size, all - begin);
  if (count < size) complain(in_file("read past the end", header.file));
  std::copy_n(registers_.bytes(header.file) + begin, count, data);
  std::fill_n(data + count, size - count, std::uint8_t{0});
}

void Chip::write(const SpiHeader& header, const std::uint8_t* data, std::size_t size, bool corrupt) {
  const std::size_t all = Registers::size(header.file);
  const std::size_t begin = std::min<std::size_t>(header.index, all);
  const std::size_t count = std::min(size, all - begin);
  if (count < size) complain(in_file("write past the end", header.file));
  const std::uint64_t power_before = registers_.get(reg::kPmscCtrl0);
  std::uint8_t* to = registers_.bytes(header.file) + begin;
  if (header.file == reg::kSysStatus.file)
    registers_.set(reg::kSysStatus, 0);  // what is not written clears nothing
  bool to_read_only = false, to_reserved = false;
  for (std::size_t i = 0; i < count; ++i) {
    const Registers::Access access = Registers::access(header.file, begin + i);
    to_read_only |= access == Registers::Access::kReadOnly;
    to_reserved |= access == Registers::Access::kReserved;
    const std::uint8_t byte = corrupt ? corrupted(data[i]) : data[i];
    if (access != Registers::Access::kReadOnly) to[i] = byte;
  }
  if (to_read_only) complain(in_file("write to a read-only part", header.file));
  if (to_reserved) complain(in_file("write to a reserved part", header.file));
  if (header.file == reg::kPmscCtrl0.file) control_power(power_before);
  if (count > 0) after_write(header.file, begin, begin + count);
}

void Chip::after_write(std::uint8_t file, std::size_t begin, std::size_t end) {
  const auto touches = [&](const Register& where) {
    return file == where.file && begin < std::size_t{where.offset} + where.size && end > where.offset;
  };
  if (touches(reg::kSysCtrl)) {
    const std::uint64_t bits = registers_.get(reg::kSysCtrl);
    registers_.set(reg::kSysCtrl, 0);
    command(bits);
  } else if (touches(reg::kSysStatus)) {
    clear_status(registers_.get(reg::kSysStatus) & ~status::kReadOnly);
  } else if (touches(reg::kSysMask)) {
    update_line();
  } else if (touches(reg::kSysCfg)) {
    configure();
  } else if (touches(reg::kTxBuffer) && radio_ == Radio::kSend) {
    complain("write to TX_BUFFER while a frame is sent");
  } else if (touches(reg::kTcSarc)) {
    convert_temperature();
  } else if (touches(reg::kAonCtrl)) {
    control_always_on();
  } else if (touches(reg::kOtpCtrl) || touches(reg::kOtpSf)) {
    control_otp();
  }
}

// --- What registers do ---

void Chip::set_status(std::uint64_t bits) {
  status_ |= bits;
  update_line();
}

void Chip::clear_status(std::uint64_t bits) {
  status_ &= ~bits;
  update_line();
}

bool Chip::interrupt() const { return line_; }

void Chip::update_line() {
  const bool alive = power_ == Power::kInit || power_ == Power::kOn;
  const bool pending = (status_ & registers_.get(reg::kSysMask) & status::kMaskable) != 0;
  const bool high_when_pending = (registers_.get(reg::kSysCfg) & cfg::kInterruptHigh) != 0;
  const bool before = line_;
  line_ = alive && pending == high_when_pending;
  if (line_ && !before && on_interrupt) on_interrupt();
}

void Chip::configure() {
  const std::uint64_t bits = registers_.get(reg::kSysCfg);
  if ((bits & cfg::kFrameFilter) != 0) complain("not modelled: frame filtering");
  if ((bits & cfg::kSingleBuffer) == 0) complain("not modelled: double buffering");
  if ((bits & cfg::kReenable) != 0) complain("not modelled: the receiver turning itself on again");
  if ((bits & cfg::kAcknowledge) != 0) complain("not modelled: automatic acknowledgement");
  update_line();
}

std::uint8_t Chip::temperature_reading() const {
  const double reading = otp_temperature_ + (nature_.temperature_c - 23.0) / kDegreesPerStep;
  return static_cast<std::uint8_t>(std::lround(std::clamp(reading, 0.0, 255.0)));
}

// UM 6.4: the sensors are switched on first, then one conversion is commanded.
void Chip::convert_temperature() {
  if ((registers_.get(reg::kTcSarc) & 1U) == 0) return;
  const bool sensing = registers_.get(reg::kRfSensor1) == 0x80 && registers_.get(reg::kRfSensor2) == 0x0F;
  if (!sensing) complain("temperature measured with its sensor off");
  registers_.set(reg::kSarLtemp, sensing ? temperature_reading() : 0);
  registers_.set(reg::kSarLvbat, sensing ? otp_voltage_ : 0);
}

void Chip::control_always_on() {
  const std::uint64_t bits = registers_.get(reg::kAonCtrl);
  registers_.set(reg::kAonCtrl, bits & ~aon::kCommands);  // which clear themselves
  if ((bits & aon::kRestore) != 0) registers_.restore(saved_);
  if ((bits & aon::kSave) != 0) saved_ = registers_;
  if ((bits & (aon::kSave | aon::kUpload)) == 0) return;
  aon_wake_ = registers_.get(reg::kAonWcfg);
  aon_sleep_ = registers_.get(reg::kAonCfg0);
  if ((aon_sleep_ & aon::kSleepEnable) != 0) fall_asleep();
}

std::uint32_t Chip::otp(std::uint64_t address) const {
  switch (address) {
    case kOtpLdoTune:
      return otp_ldo_tune_;
    case kOtpVoltage:
      return otp_voltage_;
    case kOtpTemperature:
      return otp_temperature_;
    case kOtpCrystalTrim:
      return otp_crystal_trim_;
    default:
      return 0;
  }
}

void Chip::control_otp() {
  const std::uint64_t bits = registers_.get(reg::kOtpCtrl);
  if ((bits & (otp_ctrl::kReadMode | otp_ctrl::kRead)) == (otp_ctrl::kReadMode | otp_ctrl::kRead)) {
    if (!crystal_clock()) complain("OTP read without the crystal as system clock");
    registers_.set(reg::kOtpRdat, crystal_clock() ? otp(registers_.get(reg::kOtpAddr)) : random_.next());
  }
  if ((bits & otp_ctrl::kLoadMicrocode) != 0) {
    microcode_ = false;
    microcode_loading_ = (registers_.get(reg::kPmscCtrl0) & pmsc::kClocks) == pmsc::kClocksToLoad;
    if (!microcode_loading_) complain("LDE microcode loaded without the clocks that it takes");
    power_at<&Chip::load_microcode>(events_.now() + kMicrocodeTime);
  }
  registers_.set(reg::kOtpCtrl, bits & ~(otp_ctrl::kRead | otp_ctrl::kLoadMicrocode));
  if ((registers_.get(reg::kOtpSf) & otp_sf::kLoadLdoTune) != 0) registers_.set(reg::kLdoTune, otp_ldo_tune_);
  registers_.set(reg::kOtpSf, registers_.get(reg::kOtpSf) & ~otp_sf::kLoadLdoTune);
}

void Chip::load_microcode() {
  microcode_ |= microcode_loading_;
  microcode_loading_ = false;
}

void Chip::control_power(std::uint64_t before) {
  const std::uint64_t now = registers_.get(reg::kPmscCtrl0);
  if (microcode_loading_ && (now & pmsc::kClocks) != pmsc::kClocksToLoad) {
    complain("clocks changed while the LDE microcode was loading");
    microcode_loading_ = false;
  }
  if ((now & pmsc::kNoReceiverReset) == 0 && (before & pmsc::kNoReceiverReset) != 0) {
    needs_reset_ = false;
    if (radio_ == Radio::kTurnOn || radio_ == Radio::kListen || radio_ == Radio::kReceive) stop_radio();
  }
  if ((now & pmsc::kNoReset) == 0 && (before & pmsc::kNoReset) != 0) {
    if (!crystal_clock()) complain("soft reset without the crystal as system clock");
    begin();
    registers_.set(reg::kPmscCtrl0, now);
  }
}

void Chip::set_delays(Femto tx_delay, Femto rx_delay) {
  nature_.tx_delay = tx_delay;
  nature_.rx_delay = rx_delay;
}

void Chip::complain(const std::string& what) {
  std::size_t i = 0;
  while (i < complained_.size() && complained_[i].first != what) ++i;
  if (i == complained_.size()) {
    complained_.emplace_back(what, 1);
    complaints_.push_back(what);
    return;
  }
  complaints_[i] = what + ", " + std::to_string(++complained_[i].second) + " times";
}

}  // namespace air
