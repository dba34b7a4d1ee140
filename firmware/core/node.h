// A module's life: start, range in a network, tell the ranges, leave and sleep.
#pragma once

#include "calibration.h"
#include "dw1000.h"
#include "hal.h"
#include "outbox.h"
#include "ranging.h"
#include "wire.h"

struct node_settings {
  uint32_t session;  // the PAN is its lower 16 bits
  uint16_t address;  // of this module, 0 to 0xFFFD; nobody else's in the session
  uint64_t eui64;
  uint8_t key[WIRE_KEY_SIZE];  // of this module, as the room gave it
  uint32_t restarts;           // of this module so far; has to rise
  uint8_t scheme;              // timetable_scheme, where this module coordinates
  uint8_t channel;             // of the radio, and
  uint8_t prf_mhz;
  uint32_t range_s;  // how long it ranges before it sleeps; 0: until it is told to sleep
  uint32_t sleep_s;  // how long it sleeps after that; 0: it does not sleep
  struct calibration calibration;
};

enum node_state {
  NODE_SILENT,   // the radio does not answer; it is tried again
  NODE_RANGING,  // or looking for others
  NODE_LEAVING,  // its last frame is still to be sent
  NODE_ASLEEP,   // the radio sleeps; the board may too, until the deadline, and start the node anew then
};

struct node {
  const struct hal* hal;
  struct node_settings settings;
  enum node_state state;
  uint64_t began_us;       // since when it ranges, for `range_s`; board clock, as all here
  uint64_t since_us;       // begin of the state
  uint64_t wake_us;        // SILENT, ASLEEP: when it is started anew
  uint64_t calibrated_us;  // when temperature was last looked at
  uint64_t alive_us;       // when the radio last did something
  uint64_t ranging_us;     // deadline of ranging
  uint32_t sleep_s;        // once it sleeps
  struct wire_window orders;
  struct dw1000 radio;
  struct ranging ranging;
  struct outbox outbox;
};

// After power came (`radio_sleeps` false) or after the sleep. Returns the next deadline, in us of the board's
// clock.
uint64_t node_start(struct node* node, const struct hal* hal, const struct node_settings* settings,
                    bool radio_sleeps);

// To be called when the radio's interrupt line is high, and at the deadline; nothing is lost by calling it
// early. Returns the next deadline.
uint64_t node_run(struct node* node);

// A datagram came from the network. Returns the next deadline.
uint64_t node_hear(struct node* node, const uint8_t* datagram, size_t size);
