// Driver of the Decawave DW1000, 6.8 Mb/s with a preamble of 128 symbols. UM = its user manual 2.10.
#pragma once

#include "hal.h"

enum dw1000_result {
  DW1000_OK = 0,
  DW1000_ABSENT,       // no DW1000 answers
  DW1000_UNSTABLE,     // its PLL does not lock
  DW1000_TOO_LATE,     // the moment to send at had passed; nothing is sent
  DW1000_BAD_SETTING,  // no such channel, rate or size
};

struct dw1000_settings {
  uint8_t channel;  // 1, 2, 3, 4, 5 or 7
  uint8_t prf_mhz;  // 16 or 64
  uint16_t pan;
  uint16_t address;
  uint64_t eui64;
  uint32_t antenna_delay;  // ticks, of sending and receiving together: two-way ranging sees only the sum; up
                           // to 2 x 65535
};

struct dw1000 {
  const struct hal* hal;
  struct dw1000_settings settings;
  const struct dw1000_channel* channel;  // rows of the tables in dw1000_registers.h
  const struct dw1000_prf* prf;
  uint8_t temperature_at_23_c;  // raw, from the factory; 0: not there
  bool ldo_tuned;               // the factory left a tuning in the OTP that has to be loaded after sleep too
  bool listens_shortly;         // RXWTOE is set
  bool tx_clock_on;             // forced, for a delayed transmission
};

enum dw1000_event_kind {
  DW1000_NOTHING,
  DW1000_SENT,
  DW1000_RECEIVED,
  DW1000_TIMED_OUT,     // nothing came while listening with a timeout
  DW1000_BAD_RECEPTION  // something came that could not be read; the receiver has been reset
};

#define DW1000_UNKNOWN_POWER INT16_MIN
#define DW1000_UNKNOWN_CLOCK INT32_MIN
#define DW1000_MAX_FRAME 125  // bytes without the FCS, which the radio adds and checks

struct dw1000_event {
  enum dw1000_event_kind kind;
  uint64_t stamp;         // SENT, RECEIVED: ticks when the frame was at the antenna
  size_t size;            // RECEIVED: bytes in the buffer, without the FCS
  int16_t rx_power_cdbm;  // RECEIVED: 1/100 dBm in all (UM 4.7.2), and
  int16_t fp_power_cdbm;  // of the first path (UM 4.7.1)
  int32_t clock_ppb;  // RECEIVED: by how much the sender's clock is faster than this one's (UM 7.2.21, .22)
};

// Resets the radio, checks who it is, loads the LDE's microcode and sets everything. The radio is idle
// afterwards, the SPI fast.
enum dw1000_result dw1000_start(struct dw1000* radio, const struct hal* hal,
                                const struct dw1000_settings* settings);

// Listens at once, for good or until `timeout_us` (at most 67,000; 0: for good) have passed.
void dw1000_listen(struct dw1000* radio, uint32_t timeout_us);

// The stamp that a frame sent at `at` will have: the low nine bits are ignored, the antenna's delay added
// (UM 3.3).
uint64_t dw1000_stamp_of(const struct dw1000* radio, uint64_t at);

// Sends at the 40 bit moment `at` and listens afterwards if asked. Whatever the radio did before ends.
enum dw1000_result dw1000_send_at(struct dw1000* radio, uint64_t at, const uint8_t* frame, size_t size,
                                  bool then_listen);

// Neither sends nor listens.
void dw1000_idle(struct dw1000* radio);

// What the interrupt was about; called again until NOTHING. A frame's bytes go to `buffer`, which holds
// DW1000_MAX_FRAME. After RECEIVED, TIMED_OUT and BAD_RECEPTION the radio is idle.
struct dw1000_event dw1000_service(struct dw1000* radio, uint8_t* buffer);

uint64_t dw1000_now(struct dw1000* radio);  // ticks

// Another antenna delay (ticks, both ways together), as temperature changes it.
void dw1000_set_antenna_delay(struct dw1000* radio, uint32_t antenna_delay);

// Degrees Celsius in 1/100; the typical sensor if the factory left no calibration.
int16_t dw1000_temperature_cc(struct dw1000* radio);

// Deep sleep; nothing but dw1000_wake may follow.
void dw1000_sleep(struct dw1000* radio);

// Wakes a radio that sleeps, whether or not this `radio` is the one that sent it there, and writes again what
// sleep forgets.
enum dw1000_result dw1000_wake(struct dw1000* radio, const struct hal* hal,
                               const struct dw1000_settings* settings);
