// The schemes: who sends in which slot of a round. Slot 0 is the coordinator's, number 0 of the roster.
#pragma once

#include <stdint.h>

enum timetable_scheme {
  SCHEME_ONE_TO_N,   // poll, n answers, final: n + 2 frames; the default
  SCHEME_ALL_PAIRS,  // everybody once a round, each frame the first, second and third of some range: n + 1
                     // frames
  SCHEME_POLLING,    // one after the other in 7 ms slots, 80 ms of rest: 1000 / (80 + 21 n) rounds a second,
                     // for comparison
  SCHEMES,
};

#define TIMETABLE_NOBODY (-1)

uint32_t timetable_slot_us(uint8_t scheme);

// Slots of a round with so many members besides the coordinator.
unsigned timetable_slots(uint8_t scheme, unsigned members);

// A coordinator alone still says its plan, seldom: its round is one slot and then nothing for a while.
uint32_t timetable_round_us(uint8_t scheme, unsigned members);

// Number in the roster of who sends in a slot, and whom its frame is meant for (TIMETABLE_NOBODY: everybody).
int timetable_sender(uint8_t scheme, unsigned members, unsigned slot);
int timetable_addressee(uint8_t scheme, unsigned members, unsigned slot);
