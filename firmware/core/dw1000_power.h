// What the DW1000's accumulator tells of power (UM 4.7), in 1/100 dBm; DW1000_UNKNOWN_POWER where it tells
// nothing.
#pragma once

#include "dw1000_registers.h"

// Of the first path, from its three points F1, F2, F3 and the symbols accumulated.
int16_t dw1000_first_path_cdbm(const struct dw1000_prf* prf, uint16_t f1, uint16_t f2, uint16_t f3,
                               uint16_t symbols);

// In all, from CIR_PWR and the symbols accumulated.
int16_t dw1000_received_cdbm(const struct dw1000_prf* prf, uint16_t cir_power, uint16_t symbols);

// The symbols accumulated, from RXPACC and RXPACC_NOSAT; 0 where there is none.
uint16_t dw1000_symbols(uint16_t rxpacc, uint16_t rxpacc_nosat);
