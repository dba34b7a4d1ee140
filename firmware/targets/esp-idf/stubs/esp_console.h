// Stub for checking the target's sources without ESP-IDF: declarations alone, of what they use.
#pragma once

#include <stddef.h>

size_t esp_console_split_argv(char* line, char** argv, size_t argv_size);
