// Stub for checking the target's sources without ESP-IDF: declarations alone, of what they use.
#pragma once

#include <stdint.h>

#include "netinet/in.h"
#include "sys/socket.h"

uint16_t htons(uint16_t number);
int inet_pton(int family, const char* text, void* address);
