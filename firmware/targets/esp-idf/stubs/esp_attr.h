// Stub for checking the target's sources without ESP-IDF: declarations alone, of what they use.
#pragma once

#define IRAM_ATTR
