// Sending and receiving.
#include <algorithm>
#include <array>
#include <cmath>

#include "firmware/sim/chip.h"
#include "firmware/sim/chip_bits.h"
#include "firmware/sim/chip_fcs.h"

namespace air {

namespace {

constexpr std::uint64_t kHalfPeriod = std::uint64_t{1} << 39U;
constexpr std::uint64_t kMicrosecondTicks = 65'536;           // the radio's: 512 / 499.2 MHz, 1.026 us
constexpr std::uint64_t kSendTicks = 10 * kMicrosecondTicks;  // until the transmitter has power
constexpr Femto kListenTime = 16 * kMicrosecond;              // until the receiver is ready
constexpr Femto kLdeTime = 10 * kMicrosecond;  // of the search for the leading edge; ends within the header
constexpr Femto kHalfTick = kSecond / kTickHz / 2;

constexpr double kCaptureDb = 6.0;           // whoever is weaker by more than this does not disturb
constexpr double kRampDb = 2.0;              // of power, over which reception becomes sure
constexpr double kLossDbPerRegister = 10.0;  // of sensitivity, for each tuning register that is wrong

// After an error without receiver reset: the next stamp is wrong by so much (UM 4.1.6 tells that it is, not
// how much).
constexpr std::uint64_t kLeastWrongTicks = 1'300, kMostWrongTicks = 3'800;  // 20 to 60 ns

// DS: at which one in a hundred packets is lost.
double sensitivity_dbm(int kbps) { return kbps == 110 ? -106.0 : kbps == 850 ? -101.0 : -94.0; }

double ratio_of(double db) { return std::pow(10.0, db / 10.0); }

std::uint64_t in_16_bits(double value) {
  return static_cast<std::uint64_t>(std::clamp(std::round(value), 0.0, 65'535.0));
}

Phy phy_of(const Emission& emission) { return {emission.kbps, emission.prf_mhz, emission.preamble_symbols}; }

Femto sfd_begin(const Emission& emission) {
  return emission.marker - nominal_time(sfd_ticks(phy_of(emission)));
}

bool disturbs(const Arrival& other, const Arrival& one) {
  return other.emission.channel == one.emission.channel &&
         other.rx_power_dbm >= one.rx_power_dbm - kCaptureDb;
}

}  // namespace

void Chip::command(std::uint64_t bits) {
  if ((bits & ctrl::kOff) != 0) {
    if (radio_ == Radio::kSend)
      complain("not modelled: TRXOFF while a frame is sent, which is heard nevertheless");
    stop_radio();
    return;
  }
  if ((bits & ctrl::kStart) != 0) {
    start_to_send((bits & ctrl::kStartDelayed) != 0, (bits & ctrl::kOwnFcs) != 0,
                  (bits & ctrl::kThenListen) != 0);
  } else if ((bits & ctrl::kListen) != 0) {
    start_to_listen((bits & ctrl::kListenDelayed) != 0);
  }
}

// The radio has to be idle, and its clocks as they are when nobody forces them.
bool Chip::ready_to(const char* what) {
  const char* why = nullptr;
  if (power_ != Power::kOn)
    why = " before the PLL has locked";
  else if (crystal_clock())
    why = " with the system clock forced to the crystal";
  else if ((registers_.get(reg::kPmscCtrl0) & pmsc::kNoReset) != pmsc::kNoReset)
    why = " during a reset";
  else if (radio_ != Radio::kIdle)
    why = " while the radio is not idle";
  if (why != nullptr) complain(std::string(what) + why);
  return why == nullptr;
}

void Chip::stop_radio() {
  radio_ = Radio::kIdle;
  ++radio_epoch_;
  clear_status(status::kHpdWarn);
}

std::uint64_t Chip::counter() const { return crystal_.ticks(events_.now()); }

// When the counter comes there, or now if it is there already.
Femto Chip::moment_of(std::uint64_t ticks) const { return std::max(events_.now(), crystal_.when(ticks)); }

// --- Sending ---

void Chip::start_to_send(bool delayed, bool own_fcs, bool then_listen) {
  if (!ready_to("transmission")) return;
  const Tuned tuned = transmitter_of(registers_);
  const std::size_t size = registers_.get(reg::kTxFctrl) & 0x3FFU;
  const std::size_t offset = registers_.get(reg::kTxFctrl) >> 22U & 0x3FFU;
  if (!possible(tuned))
    return complain("transmission on a channel, rate, preamble or code that does not exist");
  if (size < 2 || size > 127) return complain("transmission of a frame that is not 2 to 127 bytes long");
  if (offset + size > reg::kTxBuffer.size) return complain("transmission past the end of TX_BUFFER");
  wrong_of_transmitter(
      registers_, [this](const char* name) { complain(std::string("transmission with wrong ") + name); });

  clear_status(status::kOfSending);
  radio_ = Radio::kSendLater;
  sending_ = {tuned, offset, size, 0, own_fcs, then_listen};
  const std::uint64_t header = preamble_ticks(tuned.phy) + sfd_ticks(tuned.phy), now = counter();
  std::uint64_t begin = now + kSendTicks;
  if (!delayed) {
    sending_.marker = (begin + header + kSystemTick) & ~kSystemTick;
    begin = sending_.marker - header;
  } else {
    // UM 3.3: what counts as too late is the moment of the preamble; it is sent a period later then.
    const std::uint64_t ahead = ((registers_.get(reg::kDxTime) & ~kSystemTick) - header - now) & kCounterMask;
    sending_.marker = now + ahead + header;
    if (ahead < kSendTicks)
      set_status(status::kTxPute);  // the preamble's begin is lost while the transmitter gets power
    begin = now + std::max(ahead, kSendTicks);
    warn_of_half_period(now + ahead);
  }
  radio_at<&Chip::begin_preamble>(moment_of(begin) + nature_.tx_delay);
}

void Chip::warn_of_half_period(std::uint64_t moment) {
  if (moment - counter() <= kHalfPeriod) return;
  set_status(status::kHpdWarn);
  radio_at<&Chip::end_half_period_warning>(moment_of(moment - kHalfPeriod));
}

void Chip::end_half_period_warning() { clear_status(status::kHpdWarn); }

void Chip::begin_preamble() {
  radio_ = Radio::kSend;
  const Phy& phy = sending_.tuned.phy;
  Emission emission;
  const std::uint8_t* from = registers_.bytes(reg::kTxBuffer.file) + sending_.offset;
  emission.bytes.assign(from, from + sending_.size);
  if (!sending_.own_fcs) {
    const std::uint16_t check = fcs(from, sending_.size - 2);
    emission.bytes[sending_.size - 2] = static_cast<std::uint8_t>(check);
    emission.bytes[sending_.size - 1] = static_cast<std::uint8_t>(check >> 8U);
  }
  emission.channel = sending_.tuned.channel;
  emission.preamble_code = sending_.tuned.preamble_code;
  emission.prf_mhz = phy.prf_mhz;
  emission.kbps = phy.kbps;
  emission.preamble_symbols = phy.preamble_symbols;
  // Its crystal may have turned since the command: what counts is the counter.
  const auto at_antenna = [&](std::uint64_t ticks) { return moment_of(ticks) + nature_.tx_delay; };
  const std::uint64_t header_end = sending_.marker + header_ticks(phy);
  emission.begin = events_.now();
  emission.marker = at_antenna(sending_.marker);
  emission.end = at_antenna(header_end + data_ticks(phy, sending_.size));
  emission.ppm = crystal_.ppm();
  set_status(status::kTxFrb);
  radio_at<&Chip::preamble_sent>(at_antenna(sending_.marker - sfd_ticks(phy)));
  radio_at<&Chip::header_sent>(at_antenna(header_end));
  radio_at<&Chip::frame_sent>(emission.end);
  ether_.send(*this, emission);
}

void Chip::preamble_sent() { set_status(status::kTxPrs); }

void Chip::header_sent() { set_status(status::kTxPhs); }

void Chip::frame_sent() {
  registers_.set(reg::kTxRawst, sending_.marker & kCounterMask);
  registers_.set(reg::kTxStamp, (sending_.marker + registers_.get(reg::kTxAntd)) & kCounterMask);
  stop_radio();
  if (sending_.then_listen) {
    const std::uint64_t wait = (registers_.get(reg::kAckRespT) & 0xFFFFFU) * kMicrosecondTicks;
    radio_ = Radio::kListenLater;
    if (wait == 0)
      turn_receiver_on();
    else
      radio_at<&Chip::turn_receiver_on>(moment_of(counter() + wait));
  }
  set_status(status::kTxFrs);
}

// --- Receiving ---

void Chip::start_to_listen(bool delayed) {
  if (!ready_to("reception")) return;
  radio_ = Radio::kListenLater;
  if (!delayed) return turn_receiver_on();
  const std::uint64_t now = counter();
  const std::uint64_t moment = now + (((registers_.get(reg::kDxTime) & ~kSystemTick) - now) & kCounterMask);
  warn_of_half_period(moment);
  radio_at<&Chip::turn_receiver_on>(moment_of(moment));
}

void Chip::turn_receiver_on() {
  const Tuned tuned = receiver_of(registers_);
  if (!possible(tuned)) {
    complain("reception on a channel, rate or code that does not exist");
    return stop_radio();
  }
  loss_db_ = kLossDbPerRegister * wrong_of_receiver(registers_, [this](const char* name) {
               complain(std::string("reception with wrong ") + name);
             });
  if (otp_ldo_tune_ != 0 && registers_.get(reg::kLdoTune) != otp_ldo_tune_)
    complain("LDOTUNE not loaded from the OTP");
  if (!microcode_ && (registers_.get(reg::kPmscCtrl1) & pmsc::kRunLde) != 0) {
    complain("reception without the LDE microcode");
  }
  clear_status(status::kOfReceiving);
  radio_ = Radio::kTurnOn;
  const std::uint64_t timeout = registers_.get(reg::kRxFwto) * kMicrosecondTicks;
  if ((registers_.get(reg::kSysCfg) & cfg::kTimeout) != 0) {
    radio_at<&Chip::frame_timed_out>(moment_of(counter() + timeout));
  }
  radio_at<&Chip::listen>(events_.now() + kListenTime);
}

void Chip::listen() {
  radio_ = Radio::kListen;
  listening_since_ = events_.now();
  const std::uint64_t chunks = registers_.get(reg::kDrxPreToc);
  if (chunks != 0) {
    const std::uint64_t symbols = (chunks + 1) * static_cast<std::uint64_t>(preamble_chunk(registers_));
    radio_at<&Chip::preamble_timed_out>(
        moment_of(counter() + symbols * symbol_ticks(receiver_of(registers_).phy)));
  }
  for (const Heard& heard : air_) hunt(heard);
}

void Chip::hear(const Arrival& arrival) {
  if (power_ != Power::kInit && power_ != Power::kOn) return;
  const Femto now = events_.now();
  air_.erase(std::remove_if(air_.begin(), air_.end(),
                            [now](const Heard& h) { return h.arrival.emission.end <= now; }),
             air_.end());
  air_.push_back({serial_++, arrival});
  if (radio_ == Radio::kListen) hunt(air_.back());
  if (radio_ == Radio::kReceive) collide(arrival);
}

// Its preamble is found if half of it can be heard alone, or nearly so.
void Chip::hunt(const Heard& heard) {
  const Emission& emission = heard.arrival.emission;
  const Tuned tuned = receiver_of(registers_);
  if (emission.channel != tuned.channel || emission.prf_mhz != tuned.phy.prf_mhz ||
      emission.preamble_code != tuned.preamble_code || heard.arrival.unnoticed) {
    return;
  }
  const Femto found = clear_from(heard) + nominal_time(preamble_ticks(phy_of(emission))) / 2;
  if (found > sfd_begin(emission)) return;
  events_.at(std::max(found, events_.now()), [this, epoch = radio_epoch_, serial = heard.serial] {
    if (epoch == radio_epoch_) found_preamble(serial);
  });
}

Femto Chip::clear_from(const Heard& heard) const {
  Femto from = std::max(heard.arrival.emission.begin, listening_since_);
  for (const Heard& other : air_) {
    if (other.serial >= heard.serial) break;
    if (disturbs(other.arrival, heard.arrival)) from = std::max(from, other.arrival.emission.end);
  }
  return from;
}

void Chip::found_preamble(std::uint32_t serial) {
  if (radio_ != Radio::kListen) return;  // another came first
  const auto heard =
      std::find_if(air_.begin(), air_.end(), [serial](const Heard& h) { return h.serial == serial; });
  if (heard == air_.end()) return;
  const Arrival& arrival = heard->arrival;
  const Emission& emission = arrival.emission;
  const double margin_db = arrival.rx_power_dbm - sensitivity_dbm(emission.kbps) - loss_db_;
  const double chance = 0.5 + margin_db / kRampDb;
  if (random_.uniform() >= chance) return;
  for (auto other = heard + 1; other != air_.end(); ++other) {
    if (disturbs(other->arrival, arrival) && !disturbs(arrival, other->arrival))
      return;  // drowned by what came after
  }
  radio_ = Radio::kReceive;
  receiving_.arrival = arrival;
  receiving_.damage = Damage::kNone;
  const Femto symbol = nominal_time(symbol_ticks(phy_of(emission)));
  receiving_.symbols = static_cast<int>((sfd_begin(emission) - clear_from(*heard) + symbol / 2) / symbol);
  set_status(status::kRxPrd);
  for (auto other = heard + 1; other != air_.end(); ++other) collide(other->arrival);
  const Femto sfd = emission.marker + nature_.rx_delay + arrival.stamp_error;
  radio_at<&Chip::found_sfd>(std::max(sfd, events_.now()));
}

// What fails is what is being sent when the other begins. Few bytes at the end slip past Reed-Solomon; the
// FCS finds them.
void Chip::collide(const Arrival& other) {
  const Arrival& one = receiving_.arrival;
  if (receiving_.damage != Damage::kNone || !disturbs(other, one)) return;
  const Femto now = events_.now();
  const Phy phy = phy_of(one.emission);
  constexpr std::size_t kSlippingBytes = 4;
  if (now < one.emission.marker + nominal_time(header_ticks(phy))) {
    receiving_.damage = Damage::kHeader;
  } else if (now < one.emission.end - nominal_time(data_ticks(phy, kSlippingBytes))) {
    receiving_.damage = Damage::kData;
  } else if (now < one.emission.end) {
    receiving_.damage = Damage::kCheck;
  }
}

void Chip::found_sfd() {
  const Emission& emission = receiving_.arrival.emission;
  const bool slow = receiver_of(registers_).phy.kbps == 110;
  if (slow != (emission.kbps == 110)) {  // the SFDs differ
    const std::uint64_t wait = registers_.get(reg::kDrxSfdToc) * symbol_ticks(phy_of(emission));
    radio_at<&Chip::sfd_timed_out>(moment_of(counter() + wait));
    return;
  }
  receiving_.stamp = crystal_.ticks(events_.now() + kHalfTick);
  set_status(status::kRxSfdd);
  const Femto now = events_.now();
  radio_at<&Chip::stamp>(now + kLdeTime);
  radio_at<&Chip::received_header>(now + nominal_time(header_ticks(phy_of(emission))));
  radio_at<&Chip::received_data>(now + emission.end - emission.marker);
}

// The LDE has found the first path.
void Chip::stamp() {
  if (!microcode_ || (registers_.get(reg::kPmscCtrl1) & pmsc::kRunLde) == 0) return;
  std::uint64_t raw = receiving_.stamp;
  if (needs_reset_) {
    const std::uint64_t wrong = kLeastWrongTicks + random_.next() % (kMostWrongTicks - kLeastWrongTicks);
    raw = (random_.next() & 1U) != 0 ? raw + wrong : raw - wrong;
    needs_reset_ = false;  // of the next stamp only
  }
  registers_.set(reg::kRxStamp, (raw - registers_.get(reg::kLdeRxAntd)) & kCounterMask);
  registers_.set(reg::kRxRawst, raw & ~kSystemTick & kCounterMask);
  report(receiving_.arrival);
  set_status(status::kLdeDone);
}

// Diagnostics such that the manual's formulas (UM 4.7) give back the powers.
void Chip::report(const Arrival& arrival) {
  const bool prf16 = arrival.emission.prf_mhz == 16;
  const double a_db = prf16 ? 113.77 : 121.74;
  const double symbols = receiving_.symbols;
  const double squares = symbols * symbols;
  registers_.set(reg::kCirPwr, in_16_bits(ratio_of(arrival.rx_power_dbm + a_db) * squares / 131'072.0));
  const double amplitude = std::sqrt(ratio_of(arrival.fp_power_dbm + a_db) * squares);
  // Three points of a pulse, whose squares sum up to one.
  registers_.set(reg::kFpAmpl1, in_16_bits(0.48 * amplitude));
  registers_.set(reg::kFpAmpl2, in_16_bits(0.64 * amplitude));
  registers_.set(reg::kFpAmpl3, in_16_bits(0.60 * amplitude));
  registers_.set(reg::kFpIndex,
                 750U << 6U | (random_.next() & 0x3FU));  // where the accumulator is made to put it
  registers_.set(reg::kStdNoise, 40);
}

void Chip::received_header() {
  if (receiving_.damage == Damage::kHeader) return fail(status::kRxPhe, true);
  set_status(status::kRxPhd);
}

void Chip::received_data() {
  if (receiving_.damage == Damage::kData) return fail(status::kRxRfsl, true);
  const Emission& emission = receiving_.arrival.emission;
  std::uint8_t* to = registers_.bytes(reg::kRxBuffer.file);
  const std::size_t size = std::min<std::size_t>(emission.bytes.size(), 127);
  std::copy_n(emission.bytes.begin(), size, to);
  if (receiving_.damage == Damage::kCheck && size > 0)
    to[size - 1] = static_cast<std::uint8_t>(~to[size - 1]);
  registers_.set(reg::kRxFinfo, frame_information(size));
  const std::uint64_t interval = emission.prf_mhz == 16 ? 0x01F00000 : 0x01FC0000;  // UM 7.2.21
  // UM 7.2.22: above zero if the sender's clock is the faster one.
  const double faster = (emission.ppm - crystal_.ppm()) * 1e-6 / (1.0 + crystal_.ppm() * 1e-6);
  const auto offset = static_cast<std::uint64_t>(std::llround(faster * static_cast<double>(interval)));
  registers_.set(reg::kRxTtcki, interval);
  registers_.set(reg::kRxTtcko, offset & 0x7FFFF);
  const bool good = size >= 2 && fcs(to, size - 2) == (to[size - 2] | to[size - 1] << 8U);
  stop_radio();
  set_status(status::kRxDfr | (good ? status::kRxFcg : status::kRxFce));
}

// UM 7.2.18. RXPACC counts no symbols of the SFD here, and RXPACC_NOSAT differs, which says so.
std::uint64_t Chip::frame_information(std::size_t size) {
  struct Length {
    int symbols;
    std::uint64_t code;
  };
  constexpr std::array<Length, 8> kLengths = {{{64, 0x40000},
                                               {128, 0x40800},
                                               {256, 0x41000},
                                               {512, 0x41800},
                                               {1024, 0x80000},
                                               {1536, 0x80800},
                                               {2048, 0x81000},
                                               {4096, 0xC0000}}};
  const Emission& emission = receiving_.arrival.emission;
  std::uint64_t bits = size;
  for (const Length& length : kLengths) {
    if (length.symbols == emission.preamble_symbols) bits |= length.code;
  }
  bits |= emission.kbps == 6800 ? 0x4000U : emission.kbps == 850 ? 0x2000U : 0U;
  bits |= emission.prf_mhz == 16 ? 0x10000U : 0x20000U;
  const auto symbols = static_cast<std::uint64_t>(std::min(receiving_.symbols, 0xFFF));
  registers_.set(reg::kRxpaccNosat, symbols + 1);
  return bits | symbols << 20U;
}

void Chip::fail(std::uint64_t status, bool needs_reset) {
  needs_reset_ |= needs_reset;
  stop_radio();
  set_status(status);
}

void Chip::frame_timed_out() { fail(status::kRxRfto, true); }

// UM 4.1.6: after these two the receiver needs no reset.
void Chip::preamble_timed_out() {
  if (radio_ == Radio::kListen) fail(status::kRxPto, false);
}

void Chip::sfd_timed_out() { fail(status::kRxSfdto, false); }

}  // namespace air
