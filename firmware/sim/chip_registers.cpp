#include "firmware/sim/chip_registers.h"

#include <algorithm>

namespace air {

namespace {

using Access = Registers::Access;

struct File {
  std::uint8_t number;
  std::uint16_t size;  // bytes
  Access access;       // kReserved: what kParts does not name is reserved
};

constexpr std::array kFiles = {
    File{0x00, 4, Access::kReadOnly},     File{0x01, 8, Access::kReadWrite},
    File{0x03, 4, Access::kReadWrite},    File{0x04, 4, Access::kReadWrite},
    File{0x06, 5, Access::kReadOnly},     File{0x08, 5, Access::kReadWrite},
    File{0x09, 1024, Access::kWriteOnly}, File{0x0A, 5, Access::kReadWrite},
    File{0x0C, 2, Access::kReadWrite},    File{0x0D, 4, Access::kReadWrite},
    File{0x0E, 4, Access::kReadWrite},    File{0x0F, 5, Access::kReadWrite},
    File{0x10, 4, Access::kReadOnly},     File{0x11, 1024, Access::kReadOnly},
    File{0x12, 8, Access::kReadOnly},     File{0x13, 4, Access::kReadOnly},
    File{0x14, 5, Access::kReadOnly},     File{0x15, 14, Access::kReadOnly},
    File{0x17, 10, Access::kReadOnly},    File{0x18, 2, Access::kReadWrite},
    File{0x1A, 4, Access::kReadWrite},    File{0x1D, 4, Access::kReadWrite},
    File{0x1E, 4, Access::kReadWrite},    File{0x1F, 4, Access::kReadWrite},
    File{0x21, 41, Access::kReadWrite},   File{0x23, 33, Access::kReserved},
    File{0x24, 12, Access::kReserved},    File{0x25, 4064, Access::kReadOnly},
    File{0x26, 44, Access::kReadWrite},   File{0x27, 46, Access::kReserved},
    File{0x28, 58, Access::kReserved},    File{0x2A, 52, Access::kReserved},
    File{0x2B, 21, Access::kReserved},    File{0x2C, 12, Access::kReserved},
    File{0x2D, 19, Access::kReserved},    File{0x2E, 0x2806, Access::kReserved},
    File{0x2F, 41, Access::kReserved},    File{0x36, 48, Access::kReserved},
};

struct Part {
  Register where;
  Access access;
};

constexpr Access kRw = Access::kReadWrite, kRo = Access::kReadOnly;
constexpr std::array kParts = {
    Part{reg::kAgcCtrl1, kRw},    Part{reg::kAgcTune1, kRw},
    Part{reg::kAgcTune2, kRw},    Part{reg::kAgcTune3, kRw},
    Part{reg::kAgcStat1, kRo},    Part{{0x24, 0x00, 4}, kRw},
    Part{{0x24, 0x04, 8}, kRo},  // EC_CTRL; EC_RXTC, EC_GOLP
    Part{reg::kDrxTune0b, kRw},   Part{reg::kDrxTune1a, kRw},
    Part{reg::kDrxTune1b, kRw},   Part{reg::kDrxTune2, kRw},
    Part{reg::kDrxSfdToc, kRw},   Part{reg::kDrxPreToc, kRw},
    Part{reg::kDrxTune4h, kRw},   Part{reg::kDrxCarInt, kRo},
    Part{reg::kRxpaccNosat, kRo}, Part{reg::kRfConf, kRw},
    Part{reg::kRfRxCtrlH, kRw},   Part{reg::kRfTxCtrl, kRw},
    Part{reg::kRfSensor1, kRw},   Part{reg::kRfSensor2, kRw},
    Part{reg::kRfStatus, kRo},    Part{reg::kLdoTune, kRw},
    Part{reg::kTcSarc, kRw},      Part{{0x2A, 0x03, 5}, kRo},  // TC_SARL, TC_SARW
    Part{{0x2A, 0x08, 1}, kRw},   Part{{0x2A, 0x09, 2}, kRo},  // TC_PG_CTRL, TC_PG_STATUS
    Part{reg::kTcPgDelay, kRw},   Part{{0x2A, 0x0C, 1}, kRw},  // TC_PGTEST
    Part{reg::kFsPllCfg, kRw},    Part{reg::kFsPllTune, kRw},
    Part{reg::kFsXtalt, kRw},     Part{{0x2C, 0x00, 3}, kRw},
    Part{{0x2C, 0x03, 1}, kRo},                                // AON_WCFG, AON_CTRL; AON_RDAT
    Part{{0x2C, 0x04, 1}, kRw},   Part{{0x2C, 0x06, 6}, kRw},  // AON_ADDR; AON_CFG0, AON_CFG1
    Part{{0x2D, 0x00, 10}, kRw},  Part{reg::kOtpRdat, kRo},    // OTP_WDAT to OTP_STAT
    Part{{0x2D, 0x0E, 5}, kRw},                                // OTP_SRDAT, OTP_SF
    Part{{0x2E, 0x0000, 2}, kRo}, Part{reg::kLdeCfg1, kRw},
    Part{{0x2E, 0x1000, 4}, kRo},  // LDE_THRESH; LDE_PPINDX, _PPAMPL
    Part{reg::kLdeRxAntd, kRw},   Part{reg::kLdeCfg2, kRw},
    Part{reg::kLdeRepc, kRw},     Part{{0x2F, 0x00, 4}, kRw},
    Part{{0x2F, 0x04, 24}, kRo},  Part{{0x2F, 0x24, 2}, kRw},  // EVC_CTRL; counters; DIAG_TMC
    Part{{0x36, 0x00, 8}, kRw},   Part{{0x36, 0x0C, 1}, kRw},  // PMSC_CTRL0, PMSC_CTRL1; PMSC_SNOZT
    Part{{0x36, 0x26, 6}, kRw},                                // PMSC_TXFSEQ, PMSC_LEDC
};

constexpr std::size_t kNumbers = 64;  // six bits

struct Layout {
  std::array<std::uint16_t, kNumbers> begin{}, size{};
  std::size_t bytes = 0;
};

constexpr Layout lay_out() {
  Layout layout;
  for (const File& file : kFiles) {
    layout.begin[file.number] = static_cast<std::uint16_t>(layout.bytes);
    layout.size[file.number] = file.size;
    layout.bytes += file.size;
  }
  return layout;
}

constexpr Layout kLayout = lay_out();

constexpr std::array<Access, kLayout.bytes> all_access() {
  std::array<Access, kLayout.bytes> all{};
  for (const File& file : kFiles) {
    for (std::size_t i = 0; i < file.size; ++i) all[kLayout.begin[file.number] + i] = file.access;
  }
  for (const Part& part : kParts) {
    const std::size_t begin = kLayout.begin[part.where.file] + std::size_t{part.where.offset};
    for (std::size_t i = 0; i < part.where.size; ++i) all[begin + i] = part.access;
  }
  return all;
}

constexpr std::array<Access, kLayout.bytes> kAccess = all_access();

struct Value {
  Register where;
  std::uint64_t value;
};

// UM 2.5 and the registers' own descriptions; zero where none is told.
constexpr std::array kDefaults = {
    Value{reg::kDevId, 0xDECA0130},     Value{reg::kEui, 0xFFFFFFFF00000000},
    Value{reg::kPanAdr, 0xFFFFFFFF},    Value{reg::kSysCfg, 0x00001200},
    Value{reg::kTxFctrl, 0x0015400C},   Value{reg::kTxPower, 0x1E080222},
    Value{reg::kChanCtrl, 0x21040055},  Value{reg::kAgcCtrl1, 0x0001},
    Value{reg::kAgcTune1, 0x889B},      Value{reg::kAgcTune3, 0x0055},
    Value{reg::kDrxTune0b, 0x0001},     Value{reg::kDrxTune1a, 0x0087},
    Value{reg::kDrxTune1b, 0x0020},     Value{reg::kDrxTune2, 0x311E0035},
    Value{reg::kDrxSfdToc, 0x1041},     Value{reg::kDrxTune4h, 0x0028},
    Value{reg::kRfRxCtrlH, 0xD8},       Value{reg::kRfTxCtrl, 0x001E3DE0},
    Value{reg::kLdoTune, 0x8888888888}, Value{reg::kTcPgDelay, 0xC5},
    Value{reg::kFsPllCfg, 0x0800041D},  Value{reg::kFsPllTune, 0x46},
    Value{reg::kFsXtalt, 0x60},         Value{reg::kAonCfg0, 0x50FF1FEE},
    Value{reg::kAonCfg1, 0x0007},       Value{reg::kLdeCfg1, 0x6C},
    Value{reg::kPmscCtrl0, 0xF0300200}, Value{reg::kPmscCtrl1, 0x81020738},
};

// What sleep keeps: configuration. Not the EUI, the transmitter's antenna delay, the LDO tuning (ONW_LLDO
// loads that), data, commands and reports (UM 2.4.1.2).
constexpr std::array kKept = {
    reg::kPanAdr,    reg::kSysCfg,    reg::kTxFctrl,   reg::kRxFwto,    reg::kSysMask,   reg::kAckRespT,
    reg::kRxSniff,   reg::kTxPower,   reg::kChanCtrl,  reg::kUsrSfd,    reg::kAgcCtrl1,  reg::kAgcTune1,
    reg::kAgcTune2,  reg::kAgcTune3,  reg::kGpio,      reg::kDrxTune0b, reg::kDrxTune1a, reg::kDrxTune1b,
    reg::kDrxTune2,  reg::kDrxSfdToc, reg::kDrxPreToc, reg::kDrxTune4h, reg::kRfConf,    reg::kRfRxCtrlH,
    reg::kRfTxCtrl,  reg::kTcPgDelay, reg::kFsPllCfg,  reg::kFsPllTune, reg::kFsXtalt,   reg::kLdeCfg1,
    reg::kLdeRxAntd, reg::kLdeCfg2,   reg::kLdeRepc,   reg::kPmscCtrl0, reg::kPmscCtrl1,
};

// Bits of PMSC_CTRL0 that sleep does not keep: GPDCE, KHZCLEN.
constexpr std::uint64_t kForgottenClocks = 0x00840000;

}  // namespace

void Registers::reset() {
  static_assert(kBytes == kLayout.bytes);
  bytes_.fill(0);
  for (const Value& value : kDefaults) set(value.where, value.value);
}

void Registers::copy(const Register& where, const Registers& from) {
  std::copy_n(from.bytes(where.file) + where.offset, where.size, bytes(where.file) + where.offset);
}

void Registers::restore(const Registers& saved) {
  for (const Register& where : kKept) copy(where, saved);
  set(reg::kPmscCtrl0, get(reg::kPmscCtrl0) & ~kForgottenClocks);
  // UM 7.2.26: the high octet of the receiver's delay comes to lie over the low octet of the transmitter's.
  set(reg::kTxAntd, get(reg::kLdeRxAntd) >> 8U);
}

std::size_t Registers::size(std::uint8_t file) { return kLayout.size[file % kNumbers]; }

Registers::Access Registers::access(std::uint8_t file, std::size_t offset) {
  return kAccess[kLayout.begin[file] + offset];
}

std::uint8_t* Registers::bytes(std::uint8_t file) { return bytes_.data() + kLayout.begin[file]; }

const std::uint8_t* Registers::bytes(std::uint8_t file) const { return bytes_.data() + kLayout.begin[file]; }

std::uint64_t Registers::get(const Register& where) const {
  const std::uint8_t* from = bytes(where.file) + where.offset;
  std::uint64_t value = 0;
  for (std::size_t i = where.size; i-- > 0;) value = value << 8U | from[i];
  return value;
}

void Registers::set(const Register& where, std::uint64_t value) {
  std::uint8_t* to = bytes(where.file) + where.offset;
  for (std::size_t i = 0; i < where.size; ++i, value >>= 8U) to[i] = static_cast<std::uint8_t>(value);
}

std::optional<SpiHeader> decode_header(const std::uint8_t* header, std::size_t size) {
  if (size == 0) return std::nullopt;
  SpiHeader found;
  found.write = (header[0] & 0x80U) != 0;
  found.file = header[0] & 0x3FU;
  std::size_t length = 1;
  if ((header[0] & 0x40U) != 0) {
    if (size < 2) return std::nullopt;
    length = 2;
    found.index = header[1] & 0x7FU;
    if ((header[1] & 0x80U) != 0) {
      if (size < 3) return std::nullopt;
      length = 3;
      found.index = static_cast<std::uint16_t>(found.index | header[2] << 7U);
    }
  }
  if (length != size) return std::nullopt;
  return found;
}

}  // namespace air
