#include "frame.h"

#include "bytes.h"
#include "ticks.h"
#include "timetable.h"

// IEEE 802.15.4-2011, 5.2.1.1: a data frame, PAN compressed, both addresses short.
#define DATA_FRAME 0x8841

enum { HAS_PLAN = 1, LEAVING = 2, JOINING = 4, ALL_FLAGS = HAS_PLAN | LEAVING | JOINING };

#define ALL_MEMBERS ((1U << FRAME_MEMBERS) - 1)

// Header, word, a stamp of each member, and the plan.
_Static_assert(9 + 13 + 6 * FRAME_MEMBERS + 14 + 2 * (FRAME_MEMBERS - 1) <= FRAME_MAX,
               "no frame is too long");

// Nobody is in it twice.
static bool plan_sayable(const struct frame_plan* plan, uint16_t coordinator) {
  if (plan->scheme >= SCHEMES || plan->members > FRAME_MEMBERS - 1 || plan->time_ns > FRAME_LATEST_NS)
    return false;
  for (unsigned i = 0; i < plan->members; ++i) {
    if (plan->member[i] > FRAME_LAST_ADDRESS || plan->member[i] == coordinator) return false;
    for (unsigned j = 0; j < i; ++j) {
      if (plan->member[j] == plan->member[i]) return false;
    }
  }
  return true;
}

static bool sayable(const struct frame* frame) {
  if (frame->from > FRAME_LAST_ADDRESS) return false;
  if (frame->kind == FRAME_JOIN) return true;
  if (frame->kind != FRAME_WORD || frame->sent > TICKS_MASK || frame->heard > ALL_MEMBERS) return false;
  for (unsigned i = 0; i < FRAME_MEMBERS; ++i) {
    if ((frame->heard >> i & 1) != 0 && frame->stamp[i].received > TICKS_MASK) return false;
  }
  return !frame->has_plan || (frame->slot == 0 && plan_sayable(&frame->plan, frame->from));
}

static void put(uint8_t** to, uint64_t value, unsigned size) {
  bytes_put(*to, value, size);
  *to += size;
}

static void put_stamps(uint8_t** to, const struct frame* frame) {
  put(to, frame->heard, 2);
  for (unsigned i = 0; i < FRAME_MEMBERS; ++i) {
    if ((frame->heard >> i & 1) == 0) continue;
    put(to, frame->stamp[i].sequence, 1);
    put(to, frame->stamp[i].received, 5);
  }
}

static void put_plan(uint8_t** to, const struct frame_plan* plan) {
  put(to, plan->epoch, 4);
  put(to, plan->time_ns, 8);
  put(to, plan->scheme, 1);
  put(to, plan->members, 1);
  for (unsigned i = 0; i < plan->members; ++i) put(to, plan->member[i], 2);
}

static unsigned flags_of(const struct frame* frame) {
  unsigned flags = frame->leaving ? LEAVING : 0;
  if (frame->has_plan) flags |= frame->plan.joining ? HAS_PLAN | JOINING : HAS_PLAN;
  return flags;
}

size_t frame_write(const struct frame* frame, uint8_t bytes[FRAME_MAX]) {
  if (!sayable(frame)) return 0;
  uint8_t* to = bytes;
  put(&to, DATA_FRAME, 2);
  put(&to, frame->sequence, 1);
  put(&to, frame->pan, 2);
  put(&to, frame->to, 2);
  put(&to, frame->from, 2);
  put(&to, frame->kind, 1);
  if (frame->kind == FRAME_WORD) {
    put(&to, flags_of(frame), 1);
    put(&to, frame->roster, 1);
    put(&to, frame->round, 2);
    put(&to, frame->slot, 1);
    put(&to, frame->sent, 5);
    put_stamps(&to, frame);
    if (frame->has_plan) put_plan(&to, &frame->plan);
  }
  return (size_t)(to - bytes);
}

struct reader {
  const uint8_t* at;
  size_t left;
  bool short_of;  // bytes were asked for that are not there
};

static uint64_t get(struct reader* from, unsigned size) {
  if (from->left < size) {
    from->short_of = true;
    from->left = 0;
    return 0;
  }
  const uint64_t value = bytes_get(from->at, size);
  from->at += size;
  from->left -= size;
  return value;
}

static void get_stamps(struct reader* from, struct frame* frame) {
  frame->heard = (uint16_t)get(from, 2);
  for (unsigned i = 0; i < FRAME_MEMBERS; ++i) {
    if ((frame->heard >> i & 1) == 0) continue;
    frame->stamp[i].sequence = (uint8_t)get(from, 1);
    frame->stamp[i].received = get(from, 5);
  }
}

static void get_plan(struct reader* from, struct frame_plan* plan) {
  plan->epoch = (uint32_t)get(from, 4);
  plan->time_ns = get(from, 8);
  plan->scheme = (uint8_t)get(from, 1);
  plan->members = (uint8_t)get(from, 1);
  for (unsigned i = 0; i < plan->members && i < FRAME_MEMBERS - 1; ++i) {
    plan->member[i] = (uint16_t)get(from, 2);
  }
}

// False where a flag is set that says nothing.
static bool get_flags(struct reader* from, struct frame* frame) {
  const unsigned flags = (unsigned)get(from, 1);
  frame->leaving = (flags & LEAVING) != 0;
  frame->has_plan = (flags & HAS_PLAN) != 0;
  frame->plan.joining = (flags & JOINING) != 0;
  return (flags & ~(unsigned)ALL_FLAGS) == 0 && (frame->has_plan || !frame->plan.joining);
}

bool frame_read(const uint8_t* bytes, size_t size, struct frame* frame) {
  struct reader from = {.at = bytes, .left = size};
  *frame = (struct frame){0};
  if (get(&from, 2) != DATA_FRAME) return false;
  frame->sequence = (uint8_t)get(&from, 1);
  frame->pan = (uint16_t)get(&from, 2);
  frame->to = (uint16_t)get(&from, 2);
  frame->from = (uint16_t)get(&from, 2);
  const uint64_t kind = get(&from, 1);
  if (kind != FRAME_WORD && kind != FRAME_JOIN) return false;
  frame->kind = (enum frame_kind)kind;
  if (frame->kind == FRAME_WORD) {
    if (!get_flags(&from, frame)) return false;
    frame->roster = (uint8_t)get(&from, 1);
    frame->round = (uint16_t)get(&from, 2);
    frame->slot = (uint8_t)get(&from, 1);
    frame->sent = get(&from, 5);
    get_stamps(&from, frame);
    if (frame->has_plan) get_plan(&from, &frame->plan);
  }
  return !from.short_of && from.left == 0 && sayable(frame);
}
