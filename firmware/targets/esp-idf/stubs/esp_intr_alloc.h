// Stub for checking the target's sources without ESP-IDF: declarations alone, of what they use.
#pragma once

#define ESP_INTR_FLAG_IRAM (1 << 10)
