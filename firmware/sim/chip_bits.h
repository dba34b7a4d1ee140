// Bits of the registers that the model looks at (UM 7.2).
#pragma once

#include <cstdint>

namespace air {

constexpr std::uint64_t kCounterMask = (std::uint64_t{1} << 40U) - 1;
constexpr std::uint64_t kSystemTick = 0x1FF;  // the counter goes at 125 MHz: its low nine bits are zero

namespace status {
constexpr std::uint64_t kIrqs = 1U << 0U, kCpLock = 1U << 1U, kTxFrb = 1U << 4U, kTxPrs = 1U << 5U,
                        kTxPhs = 1U << 6U;
constexpr std::uint64_t kTxFrs = 1U << 7U, kRxPrd = 1U << 8U, kRxSfdd = 1U << 9U, kLdeDone = 1U << 10U;
constexpr std::uint64_t kRxPhd = 1U << 11U, kRxPhe = 1U << 12U, kRxDfr = 1U << 13U, kRxFcg = 1U << 14U;
constexpr std::uint64_t kRxFce = 1U << 15U, kRxRfsl = 1U << 16U, kRxRfto = 1U << 17U, kLdeErr = 1U << 18U;
constexpr std::uint64_t kRxPto = 1U << 21U, kSlp2Init = 1U << 23U, kRxSfdto = 1U << 26U, kHpdWarn = 1U << 27U;
constexpr std::uint64_t kTxPute = std::uint64_t{1} << 34U;
constexpr std::uint64_t kMaskable = 0x3FF7FFFE;                      // may interrupt (UM 7.2.16)
constexpr std::uint64_t kReadOnly = kIrqs | kHpdWarn | 0xC0000000U;  // and HSRBP, ICRBP
constexpr std::uint64_t kOfSending = kTxFrb | kTxPrs | kTxPhs | kTxFrs | kTxPute;  // cleared by the next
constexpr std::uint64_t kOfReceiving = kRxPrd | kRxSfdd | kLdeDone | kRxPhd | kRxPhe | kRxDfr | kRxFcg |
                                       kRxFce | kRxRfsl | kRxRfto | kLdeErr | kRxPto |
                                       kRxSfdto;  // cleared by the next
}  // namespace status

namespace ctrl {  // SYS_CTRL
constexpr std::uint64_t kOwnFcs = 1U << 0U, kStart = 1U << 1U, kStartDelayed = 1U << 2U, kOff = 1U << 6U;
constexpr std::uint64_t kThenListen = 1U << 7U, kListen = 1U << 8U, kListenDelayed = 1U << 9U;
}  // namespace ctrl

namespace cfg {  // SYS_CFG
constexpr std::uint64_t kFrameFilter = 1U << 0U, kInterruptHigh = 1U << 9U, kSingleBuffer = 1U << 12U;
constexpr std::uint64_t kLongFrames = 3U << 16U, kTimeout = 1U << 28U, kReenable = 1U << 29U,
                        kAcknowledge = 1U << 30U;
}  // namespace cfg

namespace aon {
constexpr std::uint64_t kMeasure = 0x0001, kLoadConfiguration = 0x0040, kLoadMicrocode = 0x0800,
                        kLoadLdoTune = 0x1000;                                            // AON_WCFG
constexpr std::uint64_t kRestore = 0x01, kSave = 0x02, kUpload = 0x04, kCommands = 0x07;  // AON_CTRL
constexpr std::uint64_t kSleepEnable = 0x01, kWakeBySpi = 0x04;                           // AON_CFG0
constexpr std::uint64_t kSleepCounter = 0x01, kSmxx = 0x02;                               // AON_CFG1
}  // namespace aon

namespace otp_ctrl {
constexpr std::uint64_t kReadMode = 0x0001, kRead = 0x0002, kLoadMicrocode = 0x8000;
}  // namespace otp_ctrl

namespace otp_sf {
constexpr std::uint64_t kLoadLdoTune = 0x02;
}  // namespace otp_sf

namespace pmsc {  // PMSC_CTRL0, PMSC_CTRL1
constexpr std::uint64_t kSysClocks = 0x3, kSysClockCrystal = 0x1;
constexpr std::uint64_t kClocks = 0xFFFF, kClocksToLoad = 0x0301;  // UM table 4
constexpr std::uint64_t kNoReset = 0xF0000000, kNoReceiverReset = 0x10000000;
constexpr std::uint64_t kRunLde = 0x00020000;
}  // namespace pmsc

}  // namespace air
