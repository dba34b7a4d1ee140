// The battery, at the start.
#pragma once

#include <stdbool.h>

// False where its voltage is known and too low to range.
bool battery_suffices(void);
