// What is said on the air: IEEE 802.15.4 data frames with short addresses (FCF 0x8841). The layout is the
// table "On the air" in PROTOCOL.md.
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define FRAME_MAX 125     // bytes without the FCS
#define FRAME_MEMBERS 11  // in a network, its coordinator among them
#define FRAME_EVERYBODY 0xFFFF
#define FRAME_LATEST_NS (UINT64_C(1) << 62)  // of a network's clock
#define FRAME_LAST_ADDRESS 0xFFFD            // 0xFFFE is a device without a short address (IEEE 802.15.4)

enum frame_kind {
  FRAME_WORD = 1,  // stamps, and from the coordinator the plan
  FRAME_JOIN = 2,  // whoever sends it asks to be taken up
};

// When a member's latest frame came in.
struct frame_stamp {
  uint8_t sequence;   // of that frame
  uint64_t received;  // ticks of the sender's clock
};

// What all go by; the coordinator says it at the begin of each round.
struct frame_plan {
  uint32_t epoch;    // of the network's clock: who began it, and which of its beginnings
  uint64_t time_ns;  // of the network's clock when this frame is sent
  uint8_t scheme;    // index in the timetable
  bool joining;      // slots to join in follow the round
  uint8_t members;   // besides the coordinator, up to FRAME_MEMBERS - 1
  // Their addresses: the coordinator is number 0 of the roster, these are 1, 2, ...
  uint16_t member[FRAME_MEMBERS - 1];
};

struct frame {
  enum frame_kind kind;
  uint8_t sequence;
  uint16_t pan;
  uint16_t to;
  uint16_t from;
  // Of a word:
  uint8_t roster;  // which list of members the numbers below are about
  uint16_t round;
  uint8_t slot;    // of the round
  bool leaving;    // the sender's last
  uint64_t sent;   // ticks of the sender's clock
  uint16_t heard;  // bit i: stamp[i] is of the frame of number i
  struct frame_stamp stamp[FRAME_MEMBERS];
  bool has_plan;
  struct frame_plan plan;
};

// Bytes written; 0 where the frame cannot be said (too many members, a number out of range).
size_t frame_write(const struct frame* frame, uint8_t bytes[FRAME_MAX]);

// False for whatever is not exactly such a frame; `frame` is undefined then. Whose PAN it is, the caller
// asks.
bool frame_read(const uint8_t* bytes, size_t size, struct frame* frame);
