// Where things are in the DW1000, and what has to be written there. UM = its user manual 2.10; multi-byte
// values are little-endian (UM 2.2.1).
#pragma once

#include <stdint.h>

// File and index in one number: 2E:0806 of the manual is 0x2E0806. Sections: UM 7.2.
enum dw1000_register {
  DW1000_DEV_ID = 0x000000,         // 7.2.2, 4 bytes
  DW1000_EUI = 0x010000,            // 7.2.3, 8 bytes; forgotten in sleep
  DW1000_PANADR = 0x030000,         // 7.2.5, PAN in the upper 16 bits
  DW1000_SYS_CFG = 0x040000,        // 7.2.6, 4 bytes
  DW1000_SYS_CFG_3 = 0x040003,      // its highest byte, with RXWTOE
  DW1000_SYS_TIME = 0x060000,       // 7.2.8, 5 bytes
  DW1000_TX_FCTRL = 0x080000,       // 7.2.10, 5 bytes
  DW1000_TX_BUFFER = 0x090000,      // 7.2.11
  DW1000_DX_TIME = 0x0A0000,        // 7.2.12, 5 bytes
  DW1000_RX_FWTO = 0x0C0000,        // 7.2.14, 2 bytes, of 512 / 499.2 MHz = 1.0256 us
  DW1000_SYS_CTRL = 0x0D0000,       // 7.2.15, 4 bytes
  DW1000_SYS_MASK = 0x0E0000,       // 7.2.16, 4 bytes, the bits of SYS_STATUS
  DW1000_SYS_STATUS = 0x0F0000,     // 7.2.17, 5 bytes, a 1 clears a bit
  DW1000_RX_FINFO = 0x100000,       // 7.2.18, 4 bytes
  DW1000_RX_BUFFER = 0x110000,      // 7.2.19
  DW1000_RX_FQUAL = 0x120000,       // 7.2.20: noise, F2, F3, CIR_PWR, of 2 bytes each
  DW1000_RX_TTCKO = 0x140000,       // 7.2.22, RXTOFS in the lower 19 bits, see dw1000_prf.rx_ttcki
  DW1000_RX_TIME = 0x150000,        // 7.2.23: stamp 0-4, first path index 5-6, F1 7-8, raw stamp 9-13
  DW1000_TX_TIME = 0x170000,        // 7.2.25: stamp 0-4, raw stamp 5-9
  DW1000_TX_ANTD = 0x180000,        // 7.2.26, 2 bytes; waking overwrites it with the upper byte of LDE_RXANTD
  DW1000_TX_POWER = 0x1E0000,       // 7.2.31, 4 bytes
  DW1000_CHAN_CTRL = 0x1F0000,      // 7.2.32, 4 bytes
  DW1000_AGC_TUNE1 = 0x230004,      // 7.2.36, 2 bytes
  DW1000_AGC_TUNE2 = 0x23000C,      // 4 bytes
  DW1000_AGC_TUNE3 = 0x230012,      // 2 bytes
  DW1000_EC_CTRL = 0x240000,        // 7.2.37, 4 bytes
  DW1000_DRX_TUNE0B = 0x270002,     // 7.2.40, 2 bytes
  DW1000_DRX_TUNE1A = 0x270004,     // 2 bytes
  DW1000_DRX_TUNE1B = 0x270006,     // 2 bytes
  DW1000_DRX_TUNE2 = 0x270008,      // 4 bytes
  DW1000_DRX_SFDTOC = 0x270020,     // 2 bytes, symbols; must not be 0
  DW1000_DRX_TUNE4H = 0x270026,     // 2 bytes
  DW1000_RXPACC_NOSAT = 0x27002C,   // 7.2.40.11, 2 bytes: RXPACC had its counter not stopped
  DW1000_RF_RXCTRLH = 0x28000B,     // 7.2.41, 1 byte
  DW1000_RF_TXCTRL = 0x28000C,      // 4 bytes
  DW1000_RF_SENSOR_1 = 0x280011,    // UM 6.4, 1 byte
  DW1000_RF_SENSOR_2 = 0x280012,    // 1 byte
  DW1000_TC_SARC = 0x2A0000,        // 7.2.43, 1 byte: 1 runs the ADC of voltage and temperature
  DW1000_TC_SAR_LTEMP = 0x2A0004,   // 1 byte: its latest reading of temperature
  DW1000_TC_PGDELAY = 0x2A000B,     // 1 byte
  DW1000_FS_PLLCFG = 0x2B0007,      // 7.2.44, 4 bytes
  DW1000_FS_PLLTUNE = 0x2B000B,     // 1 byte
  DW1000_FS_XTALT = 0x2B000E,       // 1 byte: trim in the lower 5 bits, 011 above
  DW1000_AON_WCFG = 0x2C0000,       // 7.2.45, 2 bytes: what is done on waking
  DW1000_AON_CTRL = 0x2C0002,       // 1 byte
  DW1000_AON_CFG0 = 0x2C0006,       // 1 byte is written, the rest is of the sleep counter
  DW1000_AON_CFG1 = 0x2C000A,       // 2 bytes, all 0 for deep sleep
  DW1000_OTP_ADDR = 0x2D0004,       // 7.2.46, 2 bytes
  DW1000_OTP_CTRL = 0x2D0006,       // 2 bytes
  DW1000_OTP_RDAT = 0x2D000A,       // 4 bytes
  DW1000_OTP_SF = 0x2D0012,         // 1 byte
  DW1000_LDE_CFG1 = 0x2E0806,       // 7.2.47, 1 byte
  DW1000_LDE_RXANTD = 0x2E1804,     // 2 bytes
  DW1000_LDE_CFG2 = 0x2E1806,       // 2 bytes
  DW1000_LDE_REPC = 0x2E2804,       // 2 bytes
  DW1000_PMSC_CTRL0 = 0x360000,     // 7.2.50, 4 bytes
  DW1000_PMSC_SOFTRESET = 0x360003  // its highest byte: one bit each part, 0 resets it
};

#define DW1000_IDENTITY 0xDECA0130u  // DEV_ID

// SYS_CFG. HIRQ_POL: the interrupt line is active high. DIS_DRXB: one receive buffer, not two. All else 0: no
// frame filter, PHR of the standard, power boosted by frame length ("smart").
#define DW1000_CFG_HIRQ_POL (1u << 9)
#define DW1000_CFG_DIS_DRXB (1u << 12)
#define DW1000_CFG_RXWTOE (1u << 28)

#define DW1000_CTRL_TXSTRT (1u << 1)
#define DW1000_CTRL_TXDLYS (1u << 2)
#define DW1000_CTRL_TRXOFF (1u << 6)
#define DW1000_CTRL_WAIT4RESP (1u << 7)
#define DW1000_CTRL_RXENAB (1u << 8)

// SYS_STATUS.
#define DW1000_CPLOCK (UINT64_C(1) << 1)
#define DW1000_TXFRB (UINT64_C(1) << 4)
#define DW1000_TXPRS (UINT64_C(1) << 5)
#define DW1000_TXPHS (UINT64_C(1) << 6)
#define DW1000_TXFRS (UINT64_C(1) << 7)
#define DW1000_RXPRD (UINT64_C(1) << 8)
#define DW1000_RXSFDD (UINT64_C(1) << 9)
#define DW1000_LDEDONE (UINT64_C(1) << 10)
#define DW1000_RXPHD (UINT64_C(1) << 11)
#define DW1000_RXPHE (UINT64_C(1) << 12)
#define DW1000_RXDFR (UINT64_C(1) << 13)
#define DW1000_RXFCG (UINT64_C(1) << 14)
#define DW1000_RXFCE (UINT64_C(1) << 15)
#define DW1000_RXRFSL (UINT64_C(1) << 16)
#define DW1000_RXRFTO (UINT64_C(1) << 17)
#define DW1000_LDEERR (UINT64_C(1) << 18)
#define DW1000_RXOVRR (UINT64_C(1) << 20)
#define DW1000_RXPTO (UINT64_C(1) << 21)
#define DW1000_RXSFDTO (UINT64_C(1) << 26)
#define DW1000_HPDWARN (UINT64_C(1) << 27)  // read only
#define DW1000_TXBERR (UINT64_C(1) << 28)
#define DW1000_AFFREJ (UINT64_C(1) << 29)
#define DW1000_RXPREJ (UINT64_C(1) << 33)
#define DW1000_TXPUTE (UINT64_C(1) << 34)

#define DW1000_SENT_BITS (DW1000_TXFRB | DW1000_TXPRS | DW1000_TXPHS | DW1000_TXFRS)
#define DW1000_RECEIVED_BITS \
  (DW1000_RXPRD | DW1000_RXSFDD | DW1000_LDEDONE | DW1000_RXPHD | DW1000_RXDFR | DW1000_RXFCG)
#define DW1000_ERROR_BITS                                                                         \
  (DW1000_RXPHE | DW1000_RXFCE | DW1000_RXRFSL | DW1000_LDEERR | DW1000_RXOVRR | DW1000_RXSFDTO | \
   DW1000_AFFREJ)
#define DW1000_TIMEOUT_BITS (DW1000_RXRFTO | DW1000_RXPTO)

// TX_FCTRL: 6.8 Mb/s, marked as for ranging, 128 symbols of preamble. Length in the lower 7 bits, with the
// FCS's 2 bytes.
#define DW1000_FCTRL_6M8 (2u << 13)
#define DW1000_FCTRL_TR (1u << 15)
#define DW1000_FCTRL_PRF_16 (1u << 16)
#define DW1000_FCTRL_PRF_64 (2u << 16)
#define DW1000_FCTRL_PREAMBLE_128 (5u << 18)

// CHAN_CTRL: where the fields begin.
#define DW1000_CHAN_TX 0
#define DW1000_CHAN_RX 4
#define DW1000_CHAN_RXFPRF 18  // 1: 16 MHz, 2: 64 MHz
#define DW1000_CHAN_TX_PCODE 22
#define DW1000_CHAN_RX_PCODE 27

#define DW1000_EC_CTRL_PLLLDT (1u << 2)  // CPLOCK can be relied upon only with this (UM 7.2.37.1)

// PMSC_CTRL0.
#define DW1000_CLOCKS_XTAL 0x01       // byte 0: the 19.2 MHz clock; the OTP is read reliably with it only
#define DW1000_CLOCKS_AUTO 0x00       // byte 0
#define DW1000_CLOCKS_TX_ON 0x20      // byte 0: the transmitter's clock always runs
#define DW1000_CLOCKS_LDE 0x0301      // bytes 0 and 1, to load the LDE's microcode (UM table 4), and
#define DW1000_CLOCKS_LDE_OFF 0x0200  // afterwards
#define DW1000_SOFTRESET_RX 0xE0
#define DW1000_SOFTRESET_NONE 0xF0

#define DW1000_OTP_CTRL_READ 0x0003  // OTPRDEN, OTPREAD
#define DW1000_OTP_CTRL_LDELOAD 0x8000
#define DW1000_OTP_SF_LDO_KICK 0x02
#define DW1000_OTP_LDOTUNE 0x004      // UM 6.3.1: lowest byte not 0 if there is one
#define DW1000_OTP_TEMPERATURE 0x009  // lowest byte: TC_SAR_LTEMP at 23 degrees
#define DW1000_OTP_XTAL_TRIM 0x01E    // lowest 5 bits
#define DW1000_XTAL_TRIM_MIDDLE 0x10
#define DW1000_XTAL_TRIM_FIXED 0x60

#define DW1000_WCFG_ONW_LDC 0x0040   // on waking load the registers,
#define DW1000_WCFG_ONW_LLDE 0x0800  // the LDE's microcode
#define DW1000_WCFG_ONW_LLDO 0x1000  // and the LDO's tuning
#define DW1000_AON_SAVE 0x02         // stores the registers, and sleeps if SLEEP_EN is set
#define DW1000_AON_SLEEP_EN 0x01
#define DW1000_AON_WAKE_SPI 0x04

// Of 6.8 Mb/s, a preamble of 128 symbols, PAC of 8, the standard's SFD of 8 symbols.
#define DW1000_AGC_TUNE2_VALUE 0x2502A907u
#define DW1000_AGC_TUNE3_VALUE 0x0035
#define DW1000_DRX_TUNE0B_VALUE 0x0001
#define DW1000_DRX_TUNE1B_VALUE 0x0020
#define DW1000_DRX_TUNE4H_VALUE 0x0028
#define DW1000_DRX_SFDTOC_VALUE (128 + 1 + 8 - 8)  // preamble + 1 + SFD - PAC (UM 7.2.40.7)
#define DW1000_LDE_CFG1_VALUE 0x6D                 // PMULT 3, NTM 13

// RXPACC counts this many symbols of the SFD too, where it equals RXPACC_NOSAT (UM 7.2.18, table 18).
#define DW1000_SFD_ACCUMULATED 5

// UM 10.5 (preamble codes; the first of each set), tables 37, 38, 40, 43, 44 and 7.2.31 (power, boosted by
// frame length). Later manuals have RF_TXCTRL 001E3FE3 (2.16) and PGDELAY B5 (2.18) for channel 5: whoever
// certifies a product measures its spectrum.
struct dw1000_channel {
  uint8_t channel;
  uint8_t rf_rxctrlh;
  uint8_t tc_pgdelay;
  uint8_t fs_plltune;
  uint32_t rf_txctrl;
  uint32_t fs_pllcfg;
  uint8_t preamble_code[2];  // PRF 16, 64
  uint16_t lde_repc[2];      // of these codes (UM table 51)
  uint32_t tx_power[2];
};

static const struct dw1000_channel dw1000_channels[] = {
    {1, 0xD8, 0xC9, 0x1E, 0x00005C40, 0x09000407, {1, 9}, {0x5998, 0x28F4}, {0x15355575, 0x07274767}},
    {2, 0xD8, 0xC2, 0x26, 0x00045CA0, 0x08400508, {3, 9}, {0x51EA, 0x28F4}, {0x15355575, 0x07274767}},
    {3, 0xD8, 0xC5, 0x56, 0x00086CC0, 0x08401009, {5, 9}, {0x451E, 0x28F4}, {0x0F2F4F6F, 0x2B4B6B8B}},
    {4, 0xBC, 0x95, 0x26, 0x00045C80, 0x08400508, {7, 17}, {0x8000, 0x3332}, {0x1F1F3F5F, 0x3A5A7A9A}},
    {5, 0xD8, 0xC0, 0xBE, 0x001E3FE0, 0x0800041D, {3, 9}, {0x51EA, 0x28F4}, {0x0E082848, 0x25456585}},
    {7, 0xBC, 0x93, 0xBE, 0x001E7DE0, 0x0800041D, {7, 17}, {0x8000, 0x3332}, {0x32527292, 0x5171B1D1}},
};

// UM tables 24, 31, 33, 50, and 4.7 for the power's constant.
struct dw1000_prf {
  uint8_t mhz;
  uint8_t rxfprf;  // in CHAN_CTRL
  uint16_t agc_tune1;
  uint16_t drx_tune1a;
  uint16_t lde_cfg2;
  uint32_t drx_tune2;
  uint32_t fctrl;
  // RXTTCKI, which is this constant (UM 7.2.21). RXTOFS / RXTTCKI is positive where the sender's clock is the
  // faster one; the manual's examples (7.2.22): 0x000E4 / 0x01F00000 is +7 ppm, 0x7FF5C / 0x01F00000 is -5
  // ppm.
  uint32_t rx_ttcki;
  uint16_t power_constant_cdb;  // A, 1/100 dB
};

static const struct dw1000_prf dw1000_prfs[2] = {
    {16, 1, 0x8870, 0x0087, 0x1607, 0x311A002D, DW1000_FCTRL_PRF_16, 0x01F00000, 11377},
    {64, 2, 0x889B, 0x008D, 0x0607, 0x313B006B, DW1000_FCTRL_PRF_64, 0x01FC0000, 12174},
};
