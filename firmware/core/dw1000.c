#include "dw1000.h"

#include "bytes.h"
#include "dw1000_power.h"
#include "dw1000_registers.h"
#include "dw1000_spi.h"
#include "ticks.h"

#define RESET_US 5000  // RSTn to a running crystal (DS 5.6.1: 3 ms)
#define LOCK_POLLS 100
#define LOCK_POLL_US 100
#define LDE_LOAD_US 150     // UM table 4
#define SENSOR_US 100       // its ADC needs 2.5 (UM 7.2.43.1)
#define WAKE_SELECT_US 600  // at least 500 (UM 2.3.2)
#define WAKE_US 4000        // to a running crystal: 3 ms
#define FCS_SIZE 2
#define STAMP_SIZE 5
#define STATUS_SIZE 5
#define DX_IGNORED UINT64_C(0x1FF)  // UM 3.3
#define MOST_ANTENNA_DELAY (2 * UINT32_C(0xFFFF))
#define MOST_CLOCK_PPB 100000  // crystals differ less (802.15.4: 20 ppm each); more is no measurement
#define TYPICAL_TEMPERATURE_AT_23_C 120  // raw, of modules whose OTP says nothing

// A status of all ones has bits that do not exist: nothing drives the line.
#define NO_STATUS UINT64_C(0xFFFFFFFFFF)
// All that ends with an action or began in it. Not CPLOCK, which stays for whoever asks, and not HPDWARN,
// which ends with its cause.
#define STALE_BITS                                                                                     \
  (DW1000_SENT_BITS | DW1000_RECEIVED_BITS | DW1000_ERROR_BITS | DW1000_TIMEOUT_BITS | DW1000_RXPREJ | \
   DW1000_TXBERR | DW1000_TXPUTE)
#define INTERRUPT_BITS (DW1000_TXFRS | DW1000_RXFCG | DW1000_ERROR_BITS | DW1000_TIMEOUT_BITS)

static void put(const struct dw1000* radio, enum dw1000_register to, uint64_t value, size_t size) {
  dw1000_write_number(radio->hal, to, value, size);
}

static uint64_t get(const struct dw1000* radio, enum dw1000_register from, size_t size) {
  return dw1000_read_number(radio->hal, from, size);
}

static void wait_us(const struct dw1000* radio, uint32_t us) { radio->hal->wait(radio->hal->board, us); }

static void spi_fast(const struct dw1000* radio, bool fast) { radio->hal->spi_fast(radio->hal->board, fast); }

// Half each way, the odd tick to the receiver.
static uint16_t tx_delay(const struct dw1000* radio) { return (uint16_t)(radio->settings.antenna_delay / 2); }

static uint16_t rx_delay(const struct dw1000* radio) {
  return (uint16_t)(radio->settings.antenna_delay - tx_delay(radio));
}

// ---- Doing nothing

// A delayed transmission may never happen, without any sign of it, unless the transmitter's clock runs before
// it is commanded (Errata 1.4, TX-1).
static void force_tx_clock(struct dw1000* radio, bool on) {
  if (radio->tx_clock_on == on) return;
  radio->tx_clock_on = on;
  put(radio, DW1000_PMSC_CTRL0, on ? DW1000_CLOCKS_TX_ON : DW1000_CLOCKS_AUTO, 1);
}

static void clear(const struct dw1000* radio, uint64_t status) {
  put(radio, DW1000_SYS_STATUS, status, STATUS_SIZE);
}

// What the ended action left in the status would be taken for the next one's.
static void stop(struct dw1000* radio) {
  put(radio, DW1000_SYS_CTRL, DW1000_CTRL_TRXOFF, 1);
  clear(radio, STALE_BITS);
  force_tx_clock(radio, false);
}

// Without it the stamp of the next frame is wrong (UM 4.1.6).
static void reset_receiver(const struct dw1000* radio) {
  put(radio, DW1000_PMSC_SOFTRESET, DW1000_SOFTRESET_RX, 1);
  put(radio, DW1000_PMSC_SOFTRESET, DW1000_SOFTRESET_NONE, 1);
}

void dw1000_idle(struct dw1000* radio) { stop(radio); }

// ---- Start

static bool choose(struct dw1000* radio, const struct hal* hal, const struct dw1000_settings* settings) {
  *radio = (struct dw1000){.hal = hal, .settings = *settings};
  for (size_t i = 0; i < sizeof dw1000_channels / sizeof *dw1000_channels; ++i) {
    if (dw1000_channels[i].channel == settings->channel) radio->channel = &dw1000_channels[i];
  }
  for (size_t i = 0; i < sizeof dw1000_prfs / sizeof *dw1000_prfs; ++i) {
    if (dw1000_prfs[i].mhz == settings->prf_mhz) radio->prf = &dw1000_prfs[i];
  }
  return radio->channel != NULL && radio->prf != NULL && settings->antenna_delay <= MOST_ANTENNA_DELAY;
}

static bool answers(const struct dw1000* radio) { return get(radio, DW1000_DEV_ID, 4) == DW1000_IDENTITY; }

static void rouse(const struct dw1000* radio) {
  radio->hal->select_for(radio->hal->board, WAKE_SELECT_US);
  wait_us(radio, WAKE_US);
}

static void reset(const struct dw1000* radio) {
  radio->hal->reset(radio->hal->board);
  wait_us(radio, RESET_US);
}

// One that sleeps does not hear its reset: a board that lost power alone finds it so.
static bool found_after_reset(const struct dw1000* radio) {
  reset(radio);
  if (answers(radio)) return true;
  rouse(radio);
  reset(radio);
  return answers(radio);
}

static bool locked(const struct dw1000* radio) {
  put(radio, DW1000_EC_CTRL, DW1000_EC_CTRL_PLLLDT, 4);
  for (int i = 0; i < LOCK_POLLS; ++i) {
    if (get(radio, DW1000_SYS_STATUS, STATUS_SIZE) & DW1000_CPLOCK) return true;
    wait_us(radio, LOCK_POLL_US);
  }
  return false;
}

// UM 6.3.3, with the crystal's clock only.
static uint32_t otp_word(const struct dw1000* radio, uint16_t address) {
  put(radio, DW1000_OTP_ADDR, address, 2);
  put(radio, DW1000_OTP_CTRL, DW1000_OTP_CTRL_READ, 1);
  put(radio, DW1000_OTP_CTRL, 0, 1);
  return (uint32_t)get(radio, DW1000_OTP_RDAT, 4);
}

// What the factory measured.
static void take_calibration(struct dw1000* radio) {
  put(radio, DW1000_PMSC_CTRL0, DW1000_CLOCKS_XTAL, 1);
  radio->ldo_tuned = (otp_word(radio, DW1000_OTP_LDOTUNE) & 0xFF) != 0;
  if (radio->ldo_tuned) put(radio, DW1000_OTP_SF, DW1000_OTP_SF_LDO_KICK, 1);
  radio->temperature_at_23_c = (uint8_t)otp_word(radio, DW1000_OTP_TEMPERATURE);
  const uint32_t trim = otp_word(radio, DW1000_OTP_XTAL_TRIM) & 0x1F;
  put(radio, DW1000_FS_XTALT, DW1000_XTAL_TRIM_FIXED | (trim == 0 ? DW1000_XTAL_TRIM_MIDDLE : trim), 1);
  put(radio, DW1000_PMSC_CTRL0, DW1000_CLOCKS_AUTO, 1);
}

// Without its microcode the leading edge detection stamps nothing. UM table 4.
static void load_lde(const struct dw1000* radio) {
  put(radio, DW1000_PMSC_CTRL0, DW1000_CLOCKS_LDE, 2);
  put(radio, DW1000_OTP_CTRL, DW1000_OTP_CTRL_LDELOAD, 2);
  wait_us(radio, LDE_LOAD_US);
  put(radio, DW1000_PMSC_CTRL0, DW1000_CLOCKS_LDE_OFF, 2);
}

static uint32_t sys_cfg(bool timeout) {
  return DW1000_CFG_HIRQ_POL | DW1000_CFG_DIS_DRXB | (timeout ? DW1000_CFG_RXWTOE : 0);
}

static uint32_t panadr(const struct dw1000* radio) {
  return (uint32_t)radio->settings.pan << 16 | radio->settings.address;
}

static unsigned prf_column(const struct dw1000* radio) { return radio->prf == &dw1000_prfs[0] ? 0 : 1; }

static uint32_t chan_ctrl(const struct dw1000* radio) {
  const uint32_t channel = radio->channel->channel;
  const uint32_t code = radio->channel->preamble_code[prf_column(radio)];
  return channel << DW1000_CHAN_TX | channel << DW1000_CHAN_RX |
         (uint32_t)radio->prf->rxfprf << DW1000_CHAN_RXFPRF | code << DW1000_CHAN_TX_PCODE |
         code << DW1000_CHAN_RX_PCODE;
}

static void write_antenna_delay(const struct dw1000* radio) {
  put(radio, DW1000_TX_ANTD, tx_delay(radio), 2);
  put(radio, DW1000_LDE_RXANTD, rx_delay(radio), 2);
}

// Everything, also where it is the reset's value: what a radio's always-on memory loads with a reset is of an
// earlier life.
static void configure(const struct dw1000* radio) {
  const struct dw1000_channel* channel = radio->channel;
  const struct dw1000_prf* prf = radio->prf;
  const unsigned column = prf_column(radio);
  const struct {
    enum dw1000_register at;
    uint32_t value;
    size_t size;
  } values[] = {
      {DW1000_PANADR, panadr(radio), 4},
      {DW1000_SYS_CFG, sys_cfg(false), 4},
      {DW1000_SYS_MASK, (uint32_t)INTERRUPT_BITS, 4},
      {DW1000_CHAN_CTRL, chan_ctrl(radio), 4},
      {DW1000_TX_POWER, channel->tx_power[column], 4},
      {DW1000_AGC_TUNE1, prf->agc_tune1, 2},
      {DW1000_AGC_TUNE2, DW1000_AGC_TUNE2_VALUE, 4},
      {DW1000_AGC_TUNE3, DW1000_AGC_TUNE3_VALUE, 2},
      {DW1000_DRX_TUNE0B, DW1000_DRX_TUNE0B_VALUE, 2},
      {DW1000_DRX_TUNE1A, prf->drx_tune1a, 2},
      {DW1000_DRX_TUNE1B, DW1000_DRX_TUNE1B_VALUE, 2},
      {DW1000_DRX_TUNE2, prf->drx_tune2, 4},
      {DW1000_DRX_SFDTOC, DW1000_DRX_SFDTOC_VALUE, 2},
      {DW1000_DRX_TUNE4H, DW1000_DRX_TUNE4H_VALUE, 2},
      {DW1000_RF_RXCTRLH, channel->rf_rxctrlh, 1},
      {DW1000_RF_TXCTRL, channel->rf_txctrl, 4},
      {DW1000_TC_PGDELAY, channel->tc_pgdelay, 1},
      {DW1000_FS_PLLCFG, channel->fs_pllcfg, 4},
      {DW1000_FS_PLLTUNE, channel->fs_plltune, 1},
      {DW1000_LDE_CFG1, DW1000_LDE_CFG1_VALUE, 1},
      {DW1000_LDE_CFG2, prf->lde_cfg2, 2},
      {DW1000_LDE_REPC, channel->lde_repc[column], 2},
  };
  for (size_t i = 0; i < sizeof values / sizeof *values; ++i) {
    put(radio, values[i].at, values[i].value, values[i].size);
  }
  const uint32_t fctrl = DW1000_FCTRL_6M8 | DW1000_FCTRL_TR | DW1000_FCTRL_PREAMBLE_128 | prf->fctrl;
  put(radio, DW1000_TX_FCTRL, fctrl, 5);  // the fifth byte: no time between frames
  put(radio, DW1000_EUI, radio->settings.eui64, 8);
  write_antenna_delay(radio);
}

enum dw1000_result dw1000_start(struct dw1000* radio, const struct hal* hal,
                                const struct dw1000_settings* settings) {
  if (!choose(radio, hal, settings)) return DW1000_BAD_SETTING;
  spi_fast(radio, false);
  if (!found_after_reset(radio)) return DW1000_ABSENT;
  if (!locked(radio)) return DW1000_UNSTABLE;
  take_calibration(radio);
  load_lde(radio);
  spi_fast(radio, true);
  configure(radio);
  stop(radio);
  return DW1000_OK;
}

// ---- Sleep

void dw1000_sleep(struct dw1000* radio) {
  stop(radio);  // it does not sleep with an interrupt pending
  put(radio, DW1000_SYS_CFG, sys_cfg(false), 4);
  const uint32_t on_wake =
      DW1000_WCFG_ONW_LDC | DW1000_WCFG_ONW_LLDE | (radio->ldo_tuned ? DW1000_WCFG_ONW_LLDO : 0);
  put(radio, DW1000_AON_WCFG, on_wake, 2);
  put(radio, DW1000_AON_CFG1, 0, 2);
  put(radio, DW1000_AON_CFG0, DW1000_AON_SLEEP_EN | DW1000_AON_WAKE_SPI, 1);
  put(radio, DW1000_AON_CTRL, 0, 1);
  put(radio, DW1000_AON_CTRL, DW1000_AON_SAVE, 1);
}

// Did it keep what it was told, or has it lost power meanwhile?
static bool remembers(const struct dw1000* radio) {
  return get(radio, DW1000_PANADR, 4) == panadr(radio) && get(radio, DW1000_CHAN_CTRL, 4) == chan_ctrl(radio);
}

enum dw1000_result dw1000_wake(struct dw1000* radio, const struct hal* hal,
                               const struct dw1000_settings* settings) {
  if (!choose(radio, hal, settings)) return DW1000_BAD_SETTING;
  spi_fast(radio, false);
  rouse(radio);
  if (!answers(radio) || !locked(radio) || !remembers(radio)) return dw1000_start(radio, hal, settings);
  stop(radio);  // had it been awake
  take_calibration(radio);
  spi_fast(radio, true);
  put(radio, DW1000_SYS_CFG, sys_cfg(false), 4);
  put(radio, DW1000_EUI, settings->eui64, 8);
  write_antenna_delay(radio);
  return DW1000_OK;
}

// ---- Sending and listening

static void set_timeout(struct dw1000* radio, bool on) {
  if (radio->listens_shortly == on) return;
  radio->listens_shortly = on;
  put(radio, DW1000_SYS_CFG_3, sys_cfg(on) >> 24, 1);
}

void dw1000_listen(struct dw1000* radio, uint32_t timeout_us) {
  stop(radio);
  set_timeout(radio, timeout_us > 0);
  if (timeout_us > 0) {
    const uint64_t units = ((uint64_t)timeout_us * 39 + 39) / 40;  // of 512 / 499.2 MHz = 40 / 39 us
    put(radio, DW1000_RX_FWTO, units < 0xFFFF ? units : 0xFFFF, 2);
  }
  put(radio, DW1000_SYS_CTRL, DW1000_CTRL_RXENAB, 2);
}

uint64_t dw1000_stamp_of(const struct dw1000* radio, uint64_t at) {
  return ticks_after(at & ~DX_IGNORED, tx_delay(radio));
}

// TX_FCTRL's upper bytes stay as configured.
static void load_frame(struct dw1000* radio, const uint8_t* frame, size_t size) {
  stop(radio);
  set_timeout(radio, false);
  if (size > 0) dw1000_write(radio->hal, DW1000_TX_BUFFER, frame, size);
  put(radio, DW1000_TX_FCTRL, DW1000_FCTRL_6M8 | DW1000_FCTRL_TR | (uint32_t)(size + FCS_SIZE), 2);
}

enum dw1000_result dw1000_send_at(struct dw1000* radio, uint64_t at, const uint8_t* frame, size_t size,
                                  bool then_listen) {
  if (size > DW1000_MAX_FRAME) return DW1000_BAD_SETTING;
  load_frame(radio, frame, size);
  put(radio, DW1000_DX_TIME, at & TICKS_MASK & ~DX_IGNORED, STAMP_SIZE);
  force_tx_clock(radio, true);
  const uint32_t listen = then_listen ? DW1000_CTRL_WAIT4RESP : 0;
  put(radio, DW1000_SYS_CTRL, DW1000_CTRL_TXSTRT | DW1000_CTRL_TXDLYS | listen, 1);
  if (get(radio, DW1000_SYS_STATUS, STATUS_SIZE) & (DW1000_HPDWARN | DW1000_TXPUTE)) {
    stop(radio);
    return DW1000_TOO_LATE;
  }
  return DW1000_OK;
}

// ---- What happened

static struct dw1000_event sent(struct dw1000* radio) {
  const struct dw1000_event event = {
      .kind = DW1000_SENT,
      .stamp = get(radio, DW1000_TX_TIME, STAMP_SIZE),
      .rx_power_cdbm = DW1000_UNKNOWN_POWER,
      .fp_power_cdbm = DW1000_UNKNOWN_POWER,
      .clock_ppb = DW1000_UNKNOWN_CLOCK,
  };
  clear(radio, DW1000_SENT_BITS);
  force_tx_clock(radio, false);
  return event;
}

static struct dw1000_event ended(const struct dw1000* radio, enum dw1000_event_kind kind) {
  put(radio, DW1000_SYS_CTRL, DW1000_CTRL_TRXOFF, 1);
  reset_receiver(radio);
  clear(radio, DW1000_RECEIVED_BITS | DW1000_ERROR_BITS | DW1000_TIMEOUT_BITS);
  return (struct dw1000_event){
      .kind = kind,
      .rx_power_cdbm = DW1000_UNKNOWN_POWER,
      .fp_power_cdbm = DW1000_UNKNOWN_POWER,
      .clock_ppb = DW1000_UNKNOWN_CLOCK,
  };
}

static int32_t clock_ppb(const struct dw1000* radio) {
  const int64_t raw = (int64_t)(get(radio, DW1000_RX_TTCKO, 3) & 0x7FFFF);
  const int64_t offset = raw < 0x40000 ? raw : raw - 0x80000;  // 19 bits, signed
  const int64_t ppb = offset * 1000000000 / (int64_t)radio->prf->rx_ttcki;
  return ppb >= -MOST_CLOCK_PPB && ppb <= MOST_CLOCK_PPB ? (int32_t)ppb : DW1000_UNKNOWN_CLOCK;
}

static void take_quality(const struct dw1000* radio, uint16_t rxpacc, struct dw1000_event* event) {
  uint8_t quality[8], time[9];
  dw1000_read(radio->hal, DW1000_RX_FQUAL, quality, sizeof quality);
  dw1000_read(radio->hal, DW1000_RX_TIME, time, sizeof time);
  const uint16_t symbols = dw1000_symbols(rxpacc, (uint16_t)get(radio, DW1000_RXPACC_NOSAT, 2));
  const uint16_t f1 = (uint16_t)bytes_get(&time[7], 2);
  const uint16_t f2 = (uint16_t)bytes_get(&quality[2], 2);
  const uint16_t f3 = (uint16_t)bytes_get(&quality[4], 2);
  event->stamp = bytes_get(time, STAMP_SIZE);
  event->fp_power_cdbm = dw1000_first_path_cdbm(radio->prf, f1, f2, f3, symbols);
  event->rx_power_cdbm = dw1000_received_cdbm(radio->prf, (uint16_t)bytes_get(&quality[6], 2), symbols);
  event->clock_ppb = clock_ppb(radio);
}

static struct dw1000_event received(const struct dw1000* radio, uint8_t* buffer) {
  const uint32_t info = (uint32_t)get(radio, DW1000_RX_FINFO, 4);
  const size_t length = info & 0x3FF;
  if (length < FCS_SIZE || length > DW1000_MAX_FRAME + FCS_SIZE) return ended(radio, DW1000_BAD_RECEPTION);
  struct dw1000_event event = {.kind = DW1000_RECEIVED, .size = length - FCS_SIZE};
  if (event.size > 0) dw1000_read(radio->hal, DW1000_RX_BUFFER, buffer, event.size);
  take_quality(radio, (uint16_t)(info >> 20), &event);
  clear(radio, DW1000_RECEIVED_BITS);
  return event;
}

struct dw1000_event dw1000_service(struct dw1000* radio, uint8_t* buffer) {
  const struct dw1000_event nothing = {
      .kind = DW1000_NOTHING,
      .rx_power_cdbm = DW1000_UNKNOWN_POWER,
      .fp_power_cdbm = DW1000_UNKNOWN_POWER,
      .clock_ppb = DW1000_UNKNOWN_CLOCK,
  };
  const uint64_t status = get(radio, DW1000_SYS_STATUS, STATUS_SIZE);
  if (status == NO_STATUS) return nothing;
  if (status & DW1000_TXFRS) return sent(radio);
  if (status & DW1000_RXFCG) {
    const bool stamped = (status & DW1000_LDEDONE) != 0 && (status & DW1000_LDEERR) == 0;
    return stamped ? received(radio, buffer) : ended(radio, DW1000_BAD_RECEPTION);
  }
  if (status & DW1000_ERROR_BITS) return ended(radio, DW1000_BAD_RECEPTION);
  if (status & DW1000_TIMEOUT_BITS) return ended(radio, DW1000_TIMED_OUT);
  return nothing;
}

// ---- Time and temperature

uint64_t dw1000_now(struct dw1000* radio) { return get(radio, DW1000_SYS_TIME, STAMP_SIZE); }

void dw1000_set_antenna_delay(struct dw1000* radio, uint32_t antenna_delay) {
  radio->settings.antenna_delay = antenna_delay < MOST_ANTENNA_DELAY ? antenna_delay : MOST_ANTENNA_DELAY;
  write_antenna_delay(radio);
}

// UM 6.4. The ADC runs once its bias does, which is switched on before its output.
int16_t dw1000_temperature_cc(struct dw1000* radio) {
  put(radio, DW1000_RF_SENSOR_1, 0x80, 1);
  put(radio, DW1000_RF_SENSOR_2, 0x0A, 1);
  put(radio, DW1000_RF_SENSOR_2, 0x0F, 1);
  put(radio, DW1000_TC_SARC, 0, 1);
  put(radio, DW1000_TC_SARC, 1, 1);
  wait_us(radio, SENSOR_US);
  const int raw = (int)get(radio, DW1000_TC_SAR_LTEMP, 1);
  put(radio, DW1000_TC_SARC, 0, 1);
  const int at_23_c =
      radio->temperature_at_23_c != 0 ? radio->temperature_at_23_c : TYPICAL_TEMPERATURE_AT_23_C;
  return (int16_t)(114 * (raw - at_23_c) + 2300);
}
