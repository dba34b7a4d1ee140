// Stub for checking the target's sources without ESP-IDF: declarations alone, of what they use.
#pragma once

#include "esp_err.h"

esp_err_t nvs_flash_init(void);
