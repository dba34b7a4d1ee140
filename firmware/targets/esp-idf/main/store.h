// What a module keeps in its flash (NVS).
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "calibration.h"
#include "wire.h"

// Who this module is and whom it tells; written at the console.
struct store_provision {
  uint32_t session;
  uint16_t address;
  uint8_t key[WIRE_KEY_SIZE];
  char ssid[33];
  char password[64];
  char collector[16];  // IPv4, in decimals
};

// False where the flash cannot be read. It is not erased then: the count of restarts would begin anew, and
// collectors would take everything for a replay.
bool store_open(void);

// False where nothing was provisioned yet.
bool store_read_provision(struct store_provision* provision);
bool store_write_provision(const struct store_provision* provision);

// What was calibrated, else the typical module's.
struct calibration store_read_calibration(void);
bool store_write_calibration(const struct calibration* calibration);

// Counts one start more. False where it could not be kept: nothing must be sent then.
bool store_count_restart(uint32_t* restarts);
