// The register set of the DW1000 (UM 7): where what is, what may be written, what it holds after a reset, and
// how a transaction's header says which (UM 2.2.1.2). What registers do is Chip's.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

namespace air {

struct Register {
  std::uint8_t file;
  std::uint16_t offset, size;  // bytes
};

namespace reg {

constexpr Register kDevId{0x00, 0, 4}, kEui{0x01, 0, 8}, kPanAdr{0x03, 0, 4}, kSysCfg{0x04, 0, 4};
constexpr Register kSysTime{0x06, 0, 5}, kTxFctrl{0x08, 0, 5}, kTxBuffer{0x09, 0, 1024}, kDxTime{0x0A, 0, 5};
constexpr Register kRxFwto{0x0C, 0, 2}, kSysCtrl{0x0D, 0, 4}, kSysMask{0x0E, 0, 4}, kSysStatus{0x0F, 0, 5};
constexpr Register kRxFinfo{0x10, 0, 4}, kRxBuffer{0x11, 0, 1024}, kStdNoise{0x12, 0, 2},
    kFpAmpl2{0x12, 2, 2};
constexpr Register kFpAmpl3{0x12, 4, 2}, kCirPwr{0x12, 6, 2}, kRxTtcki{0x13, 0, 4}, kRxTtcko{0x14, 0, 5};
constexpr Register kRxStamp{0x15, 0, 5}, kFpIndex{0x15, 5, 2}, kFpAmpl1{0x15, 7, 2}, kRxRawst{0x15, 9, 5};
constexpr Register kTxStamp{0x17, 0, 5}, kTxRawst{0x17, 5, 5}, kTxAntd{0x18, 0, 2}, kAckRespT{0x1A, 0, 4};
constexpr Register kRxSniff{0x1D, 0, 4}, kTxPower{0x1E, 0, 4}, kChanCtrl{0x1F, 0, 4}, kUsrSfd{0x21, 0, 41};
constexpr Register kAgcCtrl1{0x23, 0x02, 2}, kAgcTune1{0x23, 0x04, 2}, kAgcTune2{0x23, 0x0C, 4};
constexpr Register kAgcTune3{0x23, 0x12, 2}, kAgcStat1{0x23, 0x1E, 3};
constexpr Register kGpio{0x26, 0, 44};
constexpr Register kDrxTune0b{0x27, 0x02, 2}, kDrxTune1a{0x27, 0x04, 2}, kDrxTune1b{0x27, 0x06, 2};
constexpr Register kDrxTune2{0x27, 0x08, 4}, kDrxSfdToc{0x27, 0x20, 2}, kDrxPreToc{0x27, 0x24, 2};
constexpr Register kDrxTune4h{0x27, 0x26, 2}, kDrxCarInt{0x27, 0x28, 3}, kRxpaccNosat{0x27, 0x2C, 2};
constexpr Register kRfConf{0x28, 0x00, 4}, kRfRxCtrlH{0x28, 0x0B, 1}, kRfTxCtrl{0x28, 0x0C, 4};
constexpr Register kRfSensor1{0x28, 0x11, 1}, kRfSensor2{0x28, 0x12, 1};  // switch the sensors on (UM 6.4)
constexpr Register kRfStatus{0x28, 0x2C, 4}, kLdoTune{0x28, 0x30, 5};
constexpr Register kTcSarc{0x2A, 0x00, 2}, kSarLvbat{0x2A, 0x03, 1}, kSarLtemp{0x2A, 0x04, 1};
constexpr Register kSarWvbat{0x2A, 0x06, 1}, kSarWtemp{0x2A, 0x07, 1}, kTcPgDelay{0x2A, 0x0B, 1};
constexpr Register kFsPllCfg{0x2B, 0x07, 4}, kFsPllTune{0x2B, 0x0B, 1}, kFsXtalt{0x2B, 0x0E, 1};
constexpr Register kAonWcfg{0x2C, 0x00, 2}, kAonCtrl{0x2C, 0x02, 1}, kAon{0x2C, 0, 12},
    kAonCfg0{0x2C, 0x06, 4}, kAonCfg1{0x2C, 0x0A, 2};
constexpr Register kOtpAddr{0x2D, 0x04, 2}, kOtpCtrl{0x2D, 0x06, 2}, kOtpRdat{0x2D, 0x0A, 4},
    kOtpSf{0x2D, 0x12, 1};
constexpr Register kLdeCfg1{0x2E, 0x0806, 1}, kLdeRxAntd{0x2E, 0x1804, 2}, kLdeCfg2{0x2E, 0x1806, 2};
constexpr Register kLdeRepc{0x2E, 0x2804, 2};
constexpr Register kPmscCtrl0{0x36, 0x00, 4}, kPmscCtrl1{0x36, 0x04, 4};

}  // namespace reg

class Registers {
 public:
  // kReserved: of a file that is documented, but not told what it is for.
  enum class Access : std::uint8_t { kReserved, kReadOnly, kReadWrite, kWriteOnly };

  Registers() { reset(); }

  // What stands there after a reset; EUI is from the OTP, which is blank.
  void reset();

  // Bytes of a file; 0: the manual does not know it.
  static std::size_t size(std::uint8_t file);
  static Access access(std::uint8_t file, std::size_t offset);  // offset within its size

  std::uint8_t* bytes(std::uint8_t file);
  const std::uint8_t* bytes(std::uint8_t file) const;

  std::uint64_t get(const Register& where) const;  // of at most 8 bytes
  void set(const Register& where, std::uint64_t value);
  void copy(const Register& where, const Registers& from);

  // As after waking with what the always-on memory kept of `saved` (UM 2.4.1.2).
  void restore(const Registers& saved);

 private:
  static constexpr std::size_t kBytes = 16'898;
  std::array<std::uint8_t, kBytes> bytes_;
};

struct SpiHeader {
  bool write = false;
  std::uint8_t file = 0;
  std::uint16_t index = 0;
};

// Nothing where its length is another than its bits say.
std::optional<SpiHeader> decode_header(const std::uint8_t* header, std::size_t size);

}  // namespace air
