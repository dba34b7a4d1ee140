#include "roster.h"

int roster_find(const struct roster* roster, uint16_t address) {
  for (int i = 0; i <= roster->members; ++i) {
    if (roster->member[i].address == address) return i;
  }
  return -1;
}

static void put(struct roster* roster, unsigned number, uint16_t address, uint64_t now_us) {
  roster->member[number] = (struct roster_member){.address = address, .heard_us = now_us};
}

void roster_begin(struct roster* roster, uint16_t coordinator, uint64_t now_us) {
  ++roster->version;
  roster->members = 0;
  put(roster, 0, coordinator, now_us);
}

void roster_follow(struct roster* roster, uint16_t coordinator, uint8_t version,
                   const struct frame_plan* plan, uint64_t now_us) {
  roster->version = version;
  roster->members = plan->members;
  put(roster, 0, coordinator, now_us);
  for (unsigned i = 0; i < plan->members; ++i) put(roster, i + 1, plan->member[i], now_us);
}

void roster_tell(const struct roster* roster, struct frame_plan* plan) {
  plan->members = roster->members;
  for (unsigned i = 0; i < roster->members; ++i) plan->member[i] = roster->member[i + 1].address;
}

bool roster_add(struct roster* roster, uint16_t address, uint64_t now_us) {
  const int known = roster_find(roster, address);
  if (known < 0 && roster->members == FRAME_MEMBERS - 1) return false;
  const unsigned number = known < 0 ? ++roster->members : (unsigned)known;
  put(roster, number, address, now_us);
  ++roster->version;
  return true;
}

bool roster_drop(struct roster* roster, uint64_t heard_since_us) {
  unsigned kept = 0;
  for (unsigned i = 1; i <= roster->members; ++i) {
    const struct roster_member* member = &roster->member[i];
    if (!member->gone && member->heard_us >= heard_since_us) roster->member[++kept] = *member;
  }
  if (kept == roster->members) return false;
  roster->members = (uint8_t)kept;
  ++roster->version;
  return true;
}

void roster_take_over(struct roster* roster, unsigned us, uint64_t now_us) {
  const uint16_t address = roster->member[us].address;
  roster->member[us].gone = true;
  for (unsigned i = 1; i <= roster->members; ++i) roster->member[i].heard_us = now_us;
  (void)roster_drop(roster, 0);
  put(roster, 0, address, now_us);
}
