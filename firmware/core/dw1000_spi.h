// The DW1000's SPI transactions (UM 2.2.1): a header of one to three bytes, then data, lowest byte first.
#pragma once

#include "dw1000_registers.h"
#include "hal.h"

void dw1000_read(const struct hal* hal, enum dw1000_register from, uint8_t* data, size_t size);
void dw1000_write(const struct hal* hal, enum dw1000_register to, const uint8_t* data, size_t size);

// Numbers of 1 to 8 bytes.
uint64_t dw1000_read_number(const struct hal* hal, enum dw1000_register from, size_t size);
void dw1000_write_number(const struct hal* hal, enum dw1000_register to, uint64_t value, size_t size);
