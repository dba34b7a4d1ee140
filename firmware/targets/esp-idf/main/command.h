// What an operator types on the serial console, as words. Nothing of ESP-IDF is in here, so it is tested on
// the host.
#pragma once

#include <stdbool.h>
#include <stddef.h>

#include "calibration.h"
#include "store.h"

#define COMMAND_WORDS 7  // of the longest command

// provision SESSION ADDRESS KEY SSID PASSWORD COLLECTOR. False where anything is not as it has to be.
bool command_read_provision(size_t count, char* const* words, struct store_provision* provision);

// calibrate DELAY TEMPERATURE SIGMA: ticks of sending and receiving together, degrees Celsius, mm of a range
// (0: unknown).
bool command_read_calibration(size_t count, char* const* words, struct calibration* calibration);

// correct MEASURED TRUE: a range of this module and what it should have been, mm. Corrects the delay of the
// calibration that it was measured with.
bool command_correct_calibration(size_t count, char* const* words, struct calibration* calibration);
