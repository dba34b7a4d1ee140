// The values that the manual wants in the tuning registers, which a reset leaves wrong (UM 2.5.5 and the
// tables of UM 7.2).
#pragma once

#include <functional>

#include "firmware/sim/chip_airtime.h"
#include "firmware/sim/chip_registers.h"

namespace air {

// What channel control asks for.
struct Tuned {
  int channel = 0;
  int preamble_code = 0;
  Phy phy;
};

Tuned transmitter_of(const Registers& registers);
Tuned receiver_of(const Registers& registers);  // its preamble is the transmitter's; at 6.8 Mb/s and 850 kb/s
                                                // it is the same receiver

// Whether the chip can work there at all: a channel it has, and a preamble code of its pulse repetition
// frequency.
bool possible(const Tuned& tuned);

// Calls `wrong` with the name of each register that holds another value than the manual's; returns how many.
using Wrong = std::function<void(const char* name)>;
int wrong_of_transmitter(const Registers& registers, const Wrong& wrong);
int wrong_of_receiver(const Registers& registers, const Wrong& wrong);

// Symbols that preamble detection takes in at once.
int preamble_chunk(const Registers& registers);

}  // namespace air
