// Who is in the network: number 0 coordinates, the others follow in the order of their slots.
#pragma once

#include "frame.h"

struct roster_member {
  uint16_t address;
  bool gone;          // it said so; the next plan will be without it
  uint64_t heard_us;  // board clock
};

struct roster {
  uint8_t version;
  uint8_t members;  // besides the coordinator
  struct roster_member member[FRAME_MEMBERS];
};

// Number of an address; -1: not in it.
int roster_find(const struct roster* roster, uint16_t address);

// Nobody but its coordinator.
void roster_begin(struct roster* roster, uint16_t coordinator, uint64_t now_us);

// What another coordinator's plan says.
void roster_follow(struct roster* roster, uint16_t coordinator, uint8_t version,
                   const struct frame_plan* plan, uint64_t now_us);

void roster_tell(const struct roster* roster, struct frame_plan* plan);

// The coordinator's changes; each makes a new version, so that nobody takes numbers of one list for those of
// another. Whoever is in it already has started anew. False where it is full.
bool roster_add(struct roster* roster, uint16_t address, uint64_t now_us);
bool roster_drop(struct roster* roster,
                 uint64_t heard_since_us);  // who left or was not heard; true if there was any

// Number `us` coordinates now; who did so before is gone.
void roster_take_over(struct roster* roster, unsigned us, uint64_t now_us);
