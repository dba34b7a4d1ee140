// A radio at the other end of the SPI whose every answer is the fuzzer's: by choice that of a right one, or
// any bytes. The frames that come in are by choice such as another node might send, so that the fuzzer need
// not guess them.
#pragma once

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "frame.h"
#include "ticks.h"

// What the fuzzer says; its last byte again and again once there is no more.
struct script {
  const uint8_t* bytes;
  size_t size;
  uint8_t last;
};

static inline uint8_t script_byte(struct script* script) {
  if (script->size > 0) {
    --script->size;
    script->last = *script->bytes++;
  }
  return script->last;
}

static inline uint64_t script_number(struct script* script, size_t size) {
  uint64_t number = 0;
  for (size_t i = 0; i < size; ++i) number = number << 8 | script_byte(script);
  return number;
}

enum lying_radio_file {
  FILE_DEV_ID = 0x00,
  FILE_SYS_TIME = 0x06,
  FILE_TX_BUFFER = 0x09,
  FILE_DX_TIME = 0x0A,
  FILE_SYS_STATUS = 0x0F,
  FILE_RX_FINFO = 0x10,
  FILE_RX_BUFFER = 0x11,
  FILE_RX_TIME = 0x15,
  FILE_TX_TIME = 0x17,
  FILE_TX_ANTD = 0x18,
};

struct lying_radio {
  struct script* script;
  uint16_t pan, address;  // of the node
  uint64_t delayed_to;    // ticks, and
  uint64_t tx_delay;      // of the antenna
  uint8_t said;           // sequence of the node's latest frame
  uint64_t arrived_at;    // ticks; a frame, and
  uint8_t arrived[FRAME_MAX];
  size_t arrived_size;
  bool said_nonsense;  // the node sent what is no frame
};

static inline uint64_t lying_radio_number(const uint8_t* data, size_t size) {
  uint64_t number = 0;
  for (size_t i = 0; i < size && i < 8; ++i) number |= (uint64_t)data[i] << (8 * i);
  return number;
}

// Stamp of the node's latest delayed frame.
static inline uint64_t lying_radio_sent(const struct lying_radio* radio) {
  return ticks_after(radio->delayed_to, radio->tx_delay);
}

// One of few addresses, or the node's own.
static inline uint16_t lying_radio_address(struct lying_radio* radio) {
  const uint8_t choice = script_byte(radio->script) % 16;
  return choice == 0 ? radio->address : choice;
}

static inline void lying_radio_compose(struct lying_radio* radio, uint64_t now) {
  struct script* script = radio->script;
  radio->arrived_at = now;
  const uint8_t choice = script_byte(script);
  struct frame frame = {
      .kind = (choice & 1) ? FRAME_WORD : FRAME_JOIN,
      .sequence = script_byte(script),
      .pan = radio->pan,
      .to = (choice & 2) ? FRAME_EVERYBODY : radio->address,
      .from = lying_radio_address(radio),
      .roster = script_byte(script) % 4,
      .round = (uint16_t)script_number(script, 2),
      .slot = script_byte(script) % 16,
      .leaving = (choice & 0xC0) == 0xC0,
      .sent = now,
      .heard = (uint16_t)(script_number(script, 2) & ((1U << FRAME_MEMBERS) - 1)),
      .has_plan = (choice & 4) != 0,
  };
  for (unsigned i = 0; i < FRAME_MEMBERS; ++i) {
    frame.stamp[i].sequence = radio->said;
    frame.stamp[i].received = ticks_after(lying_radio_sent(radio), script_byte(script));
  }
  frame.plan.epoch = script_byte(script);
  frame.plan.time_ns = script_number(script, 8);
  frame.plan.scheme = script_byte(script) % 4;
  frame.plan.joining = (choice & 8) != 0;
  frame.plan.members = script_byte(script) % FRAME_MEMBERS;
  for (unsigned i = 0; i < frame.plan.members; ++i) frame.plan.member[i] = lying_radio_address(radio);
  radio->arrived_size = frame_write(&frame, radio->arrived);
}

static inline uint64_t lying_radio_status(struct lying_radio* radio) {
  static const uint64_t likely[] = {
      0x02,      // the PLL has locked
      0x00,      // or not
      0x82,      // or a frame was sent
      0x6402,    // or received, and stamped
      0x9002,    // or could not be read
      0x020002,  // or did not come in time
  };
  return likely[script_byte(radio->script) % (sizeof likely / sizeof *likely)];
}

// `now`: ticks.
static inline void lying_radio_read(struct lying_radio* radio, uint8_t file, uint64_t now, uint8_t* data,
                                    size_t size) {
  uint64_t right = 0;
  bool bytes = false;
  switch (file) {
    case FILE_DEV_ID:
      right = 0xDECA0130;
      break;
    case FILE_SYS_TIME:
      right = now;
      break;
    case FILE_SYS_STATUS:
      right = lying_radio_status(radio);
      break;
    case FILE_RX_FINFO:
      lying_radio_compose(radio, now);
      right = (radio->arrived_size + 2) | UINT64_C(128) << 20;
      break;
    case FILE_RX_TIME:
      right = ticks_after(radio->arrived_at, script_byte(radio->script));
      break;
    case FILE_TX_TIME:
      right = lying_radio_sent(radio);
      break;
    case FILE_RX_BUFFER:
      bytes = radio->arrived_size >= size;
      break;
    default:
      break;
  }
  const bool lies = script_byte(radio->script) >= 0xF0;
  for (size_t i = 0; i < size; ++i) {
    if (lies) {
      data[i] = script_byte(radio->script);
    } else if (bytes) {
      data[i] = radio->arrived[i];
    } else {
      data[i] = i < 8 ? (uint8_t)(right >> (8 * i)) : script_byte(radio->script);
    }
  }
}

static inline void lying_radio_write(struct lying_radio* radio, uint8_t file, const uint8_t* data,
                                     size_t size) {
  static struct frame frame;
  if (file == FILE_TX_ANTD) radio->tx_delay = lying_radio_number(data, size);
  if (file == FILE_DX_TIME) radio->delayed_to = lying_radio_number(data, size);
  if (file != FILE_TX_BUFFER) return;
  if (frame_read(data, size, &frame) && frame.from == radio->address && frame.pan == radio->pan) {
    radio->said = frame.sequence;
  } else {
    radio->said_nonsense = true;
  }
}
