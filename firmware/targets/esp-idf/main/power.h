// Deep sleep of the board.
#pragma once

#include <stdbool.h>
#include <stdint.h>

// Whether this start is the end of a deep sleep; the radio sleeps then.
bool power_woke(void);

// Sleeps so long (UINT64_MAX: for good) or until the button is pressed; the board starts anew then.
_Noreturn void power_sleep(uint64_t us);
