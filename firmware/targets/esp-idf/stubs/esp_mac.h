// Stub for checking the target's sources without ESP-IDF: declarations alone, of what they use.
#pragma once

#include <stdint.h>

#include "esp_err.h"

esp_err_t esp_efuse_mac_get_default(uint8_t* mac);
