// A radio that answers whatever it likes, to a node that starts, runs and is given orders. Nothing it says
// may crash the node, make it write beyond a buffer, wait in a call for ever, or send what is not a frame or
// a datagram of ours.
#include <stdio.h>
#include <stdlib.h>

#include "firmware/tests/fuzz/lying_radio.h"
#include "node.h"

#define MOST_TRANSACTIONS 20000  // in one call of the node
#define MOST_WAITING_US 2000000
#define CALLS 200

struct board {
  struct script script;
  struct lying_radio radio;
  uint64_t now_us;
  uint64_t called_us;     // when the node was last called
  unsigned transactions;  // since then
};

static const struct node_settings settings = {
    .session = 0x12345678,
    .address = 7,
    .eui64 = 0x0123456789ABCDEF,
    .key = {1, 2, 3, 4},
    .restarts = 1,
    .channel = 5,
    .prf_mhz = 64,
    .range_s = 10,
    .sleep_s = 60,
    .calibration = {.antenna_delay = 32900, .temperature_cc = 2300},
};

static void fail(const char* what) {
  fprintf(stderr, "%s\n", what);
  abort();
}

static void passes(struct board* board, uint64_t us) {
  board->now_us += us;
  if (board->now_us - board->called_us > MOST_WAITING_US) fail("the node waits for ever");
}

static void transaction(struct board* board, size_t header_size, size_t size) {
  if (header_size < 1 || header_size > 3) fail("a header of the SPI has one to three bytes");
  if (++board->transactions > MOST_TRANSACTIONS) fail("the node asks the radio for ever");
  passes(board, 4 + (header_size + size) / 2);
}

static void spi_write(void* context, const uint8_t* header, size_t header_size, const uint8_t* data,
                      size_t size) {
  struct board* board = context;
  transaction(board, header_size, size);
  lying_radio_write(&board->radio, header[0] & 0x3F, data, size);
  if (board->radio.said_nonsense) fail("the node sends what is no frame");
}

static void spi_read(void* context, const uint8_t* header, size_t header_size, uint8_t* data, size_t size) {
  struct board* board = context;
  transaction(board, header_size, size);
  lying_radio_read(&board->radio, header[0] & 0x3F, ticks_of_us(board->now_us) & TICKS_MASK, data, size);
}

static void spi_fast(void* context, bool fast) {
  (void)context;
  (void)fast;
}

static void reset(void* context) { passes(context, 100); }

static void wait(void* context, uint32_t us) { passes(context, us); }

static bool interrupted(void* context) { return script_byte(&((struct board*)context)->script) & 1; }

static uint64_t now_us(void* context) {
  passes(context, 1);
  return ((struct board*)context)->now_us;
}

static uint32_t random_number(void* context) {
  return (uint32_t)script_number(&((struct board*)context)->script, 4);
}

static bool send_datagram(void* context, const uint8_t* datagram, size_t size) {
  static struct wire_ranges ranges;
  if (size > WIRE_MAX_SIZE) fail("a datagram is too large");
  if (!wire_read_ranges(datagram, size, settings.key, &ranges)) fail("a datagram cannot be read");
  if (ranges.session != settings.session || ranges.reporter != settings.address)
    fail("a datagram is not of this node");
  return script_byte(&((struct board*)context)->script) & 1;
}

static uint64_t is_told(struct node* node, struct script* script, uint8_t choice) {
  uint8_t datagram[WIRE_MAX_SIZE];
  size_t size = choice;
  if (choice & 1) {
    const struct wire_order order = {.session = settings.session,
                                     .module = settings.address,
                                     .sequence = (uint64_t)settings.restarts << 32 | script_byte(script),
                                     .sleep_s = (uint32_t)script_number(script, 2)};
    size = wire_write_order(&order, settings.key, datagram);
  } else {
    for (size_t i = 0; i < size; ++i) datagram[i] = script_byte(script);
  }
  return node_hear(node, datagram, size);
}

int LLVMFuzzerTestOneInput(const uint8_t* bytes, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t* bytes, size_t size) {
  static struct node node;
  struct board board = {.script = {.bytes = bytes, .size = size}};
  board.radio = (struct lying_radio){
      .script = &board.script, .pan = (uint16_t)settings.session, .address = settings.address};
  const struct hal hal = {&board, spi_write,   spi_read, spi_fast,      reset,        wait,
                          wait,   interrupted, now_us,   random_number, send_datagram};

  uint64_t deadline = node_start(&node, &hal, &settings, script_byte(&board.script) & 1);
  for (int i = 0; i < CALLS && board.script.size > 0; ++i) {
    const uint8_t choice = script_byte(&board.script);
    // The interrupt comes at any time, the deadline at its own.
    const bool at_deadline = (choice & 2) && deadline > board.now_us && deadline != UINT64_MAX;
    board.now_us = at_deadline ? deadline : board.now_us + 16 * script_byte(&board.script);
    board.called_us = board.now_us;
    board.transactions = 0;
    deadline = (choice & 0xC0) == 0xC0 ? is_told(&node, &board.script, choice) : node_run(&node);
  }
  return 0;
}
