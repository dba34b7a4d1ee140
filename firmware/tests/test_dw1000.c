#include <string.h>

#include "check.h"
#include "dw1000.h"
#include "dw1000_spi.h"

// ---- A board whose radio is an array of registers and a record of what was done.

enum { FILES = 64, FILE_SIZE = 0x2810, OTP_WORDS = 0x20, STEPS = 400 };

enum step_kind { READ, WRITE, FAST, SLOW, RESET, SELECT, WAIT };

struct step {
  enum step_kind kind;
  unsigned file, index;  // READ, WRITE
  size_t size;           // of data,
  uint64_t value;        // its first eight bytes; or us
  uint8_t header[3];
  size_t header_size;
};

struct board {
  uint8_t registers[FILES][FILE_SIZE];
  uint32_t otp[OTP_WORDS];
  struct step steps[STEPS];
  unsigned count;
  bool fast;
  bool asleep;     // answers ones until it has been selected for long
  bool dead;       // answers ones
  bool babbling;   // answers anything
  bool late;       // HPDWARN after a delayed transmission
  bool too_short;  // TXPUTE instead
  bool never_locks;
  uint32_t random;
  int reads;
};

static struct step* record(struct board* board, enum step_kind kind) {
  struct step* step = &board->steps[board->count < STEPS - 1 ? board->count++ : STEPS - 1];
  *step = (struct step){.kind = kind};
  return step;
}

static uint64_t number(const uint8_t* bytes, size_t size) {
  uint64_t value = 0;
  for (size_t i = 0; i < size && i < 8; ++i) value |= (uint64_t)bytes[i] << 8 * i;
  return value;
}

static uint64_t get(const struct board* board, unsigned file, unsigned index, size_t size) {
  return number(&board->registers[file][index], size);
}

static void put(struct board* board, unsigned file, unsigned index, uint64_t value, size_t size) {
  for (size_t i = 0; i < size; ++i) board->registers[file][index + i] = (uint8_t)(value >> 8 * i);
}

static void set_status(struct board* board, uint64_t bits) {
  put(board, 0x0F, 0, get(board, 0x0F, 0, 5) | bits, 5);
}

// UM 2.2.1.
static struct step* record_transfer(struct board* board, enum step_kind kind, const uint8_t* header,
                                    size_t header_size, size_t size) {
  struct step* step = record(board, kind);
  memcpy(step->header, header, header_size);
  step->header_size = header_size;
  step->size = size;
  step->file = header[0] & 0x3F;
  CHECK_EQUAL(header[0] >> 7, kind == WRITE);
  CHECK_EQUAL(header[0] >> 6 & 1, header_size > 1);
  if (header_size > 1) {
    CHECK_EQUAL(header[1] >> 7, header_size > 2);
    step->index = header[1] & 0x7F;
  }
  if (header_size > 2) step->index |= (unsigned)header[2] << 7;
  CHECK(step->index + size <= FILE_SIZE);
  return step;
}

static void obey(struct board* board, const struct step* step, const uint8_t* data) {
  if (step->file == 0x0F) {
    const uint64_t kept = UINT64_C(1) << 27;  // HPDWARN cannot be cleared
    const uint64_t cleared = number(data, step->size) & ~kept;
    put(board, 0x0F, 0, get(board, 0x0F, 0, 5) & ~cleared, 5);
    return;
  }
  memcpy(&board->registers[step->file][step->index], data, step->size);
  if (step->file == 0x2D && step->index == 6 && step->value == 3) {
    put(board, 0x2D, 0x0A, board->otp[get(board, 0x2D, 4, 2) % OTP_WORDS], 4);
  }
  if (step->file != 0x0D) return;
  if (step->value & 0x40) put(board, 0x0F, 0, get(board, 0x0F, 0, 5) & ~(UINT64_C(1) << 27), 5);
  if (step->value & 0x04 && board->late) set_status(board, UINT64_C(1) << 27);
  if (step->value & 0x04 && board->too_short) set_status(board, UINT64_C(1) << 34);
}

static void board_write(void* me, const uint8_t* header, size_t header_size, const uint8_t* data,
                        size_t size) {
  struct board* board = me;
  struct step* step = record_transfer(board, WRITE, header, header_size, size);
  step->value = number(data, size);
  if (!board->asleep && !board->dead) obey(board, step, data);
}

static void board_read(void* me, const uint8_t* header, size_t header_size, uint8_t* data, size_t size) {
  struct board* board = me;
  struct step* step = record_transfer(board, READ, header, header_size, size);
  memcpy(data, &board->registers[step->file][step->index], size);
  if (board->asleep || board->dead) memset(data, 0xFF, size);
  for (size_t i = 0; i < size && board->babbling; ++i) {
    board->random = board->random * 1664525 + 1013904223;
    data[i] = (uint8_t)(board->random >> 24);
  }
  step->value = number(data, size);
}

static void board_fast(void* me, bool fast) {
  record(me, fast ? FAST : SLOW);
  ((struct board*)me)->fast = fast;
}

static void board_reset(void* me) {
  struct board* board = me;
  record(board, RESET);
  if (board->asleep) return;
  memset(board->registers, 0, sizeof board->registers);
  put(board, 0x00, 0, 0xDECA0130, 4);
  put(board, 0x03, 0, 0xFFFFFFFF, 4);
  if (!board->never_locks) set_status(board, 1 << 1);
}

static void board_select(void* me, uint32_t us) {
  struct board* board = me;
  record(board, SELECT)->value = us;
  if (us >= 500) board->asleep = false;
}

static void board_wait(void* me, uint32_t us) { record(me, WAIT)->value = us; }

static const struct dw1000_settings settings = {.channel = 5,
                                                .prf_mhz = 64,
                                                .pan = 0x1234,
                                                .address = 0xABCD,
                                                .eui64 = UINT64_C(0x0102030405060708),
                                                .antenna_delay = 32901};

static struct board module;
static struct dw1000 radio;
static uint8_t buffer[DW1000_MAX_FRAME + 8];

static const struct hal hal = {.board = &module,
                               .spi_write = board_write,
                               .spi_read = board_read,
                               .spi_fast = board_fast,
                               .reset = board_reset,
                               .select_for = board_select,
                               .wait = board_wait};

static void new_board(void) {
  memset(&module, 0, sizeof module);
  module.otp[0x009] = 0xFF00007B;
  module.otp[0x01E] = 0x00000109;
}

static void forget_steps(void) { module.count = 0; }

// A radio that has been started, and a record that is empty.
static void begin(void) {
  new_board();
  CHECK_EQUAL(dw1000_start(&radio, &hal, &settings), DW1000_OK);
  forget_steps();
}

// The first such write from step `from` on; the count where there is none.
static unsigned written(unsigned from, unsigned file, unsigned index, uint64_t value) {
  for (unsigned i = from; i < module.count; ++i) {
    const struct step* s = &module.steps[i];
    if (s->kind == WRITE && s->file == file && s->index == index && s->value == value) return i;
  }
  return module.count;
}

static unsigned first(enum step_kind kind) {
  unsigned i = 0;
  while (i < module.count && module.steps[i].kind != kind) ++i;
  return i;
}

#define CHECK_WRITTEN(file, index, value) CHECK(written(0, file, index, value) < module.count)
#define CHECK_NOT_WRITTEN(file, index, value) CHECK_EQUAL(written(0, file, index, value), module.count)

static unsigned transfers(void) {
  unsigned n = 0;
  for (unsigned i = 0; i < module.count; ++i)
    n += module.steps[i].kind == READ || module.steps[i].kind == WRITE;
  return n;
}

// What a reception leaves in the registers.
static void receive(const uint8_t* frame, size_t size, uint64_t stamp) {
  memcpy(module.registers[0x11], frame, size);
  put(&module, 0x10, 0, (uint64_t)120 << 20 | (size + 2), 4);
  put(&module, 0x12, 2, 9000, 2);
  put(&module, 0x12, 4, 8000, 2);
  put(&module, 0x12, 6, 5000, 2);
  put(&module, 0x15, 0, stamp, 5);
  put(&module, 0x15, 7, 10000, 2);
  put(&module, 0x27, 0x2C, 128, 2);
  set_status(&module, 0x6F00);  // RXPRD, RXSFDD, LDEDONE, RXPHD, RXDFR, RXFCG
}

static void check_reset_of_the_receiver(void) {
  const unsigned off = written(0, 0x0D, 0, 0x40);
  const unsigned down = written(off, 0x36, 3, 0xE0);
  CHECK(down < module.count);
  CHECK_EQUAL(written(down, 0x36, 3, 0xF0), down + 1);
  CHECK_EQUAL(module.steps[down].size, 1);
}

// ---- Framing

static void check_header(enum step_kind kind, unsigned file, unsigned index, size_t size,
                         const char* expected) {
  for (unsigned i = 0; i < module.count; ++i) {
    const struct step* s = &module.steps[i];
    if (s->kind != kind || s->file != file || s->index != index) continue;
    CHECK_EQUAL(s->header_size, strlen(expected));
    CHECK_EQUAL(memcmp(s->header, expected, s->header_size), 0);
    CHECK_EQUAL(s->size, size);
    return;
  }
  const bool there_is_such_a_transaction = false;
  CHECK(there_is_such_a_transaction);
}

static void headers_are_those_of_the_manual(void) {
  new_board();
  (void)dw1000_start(&radio, &hal, &settings);
  CHECK_EQUAL(module.steps[first(READ)].header[0], 0x00);  // DEV_ID: one byte, 0
  CHECK_EQUAL(module.steps[first(READ)].header_size, 1);
  check_header(WRITE, 0x03, 0, 4, "\x83");
  check_header(WRITE, 0x27, 0x26, 2, "\xE7\x26");
  check_header(READ, 0x2D, 0x0A, 4, "\x6D\x0A");
  check_header(WRITE, 0x2E, 0x0806, 1, "\xEE\x86\x10");
  check_header(WRITE, 0x2E, 0x1804, 2, "\xEE\x84\x30");
  check_header(WRITE, 0x2E, 0x2804, 2, "\xEE\x84\x50");
}

static void an_index_takes_the_bytes_it_needs(void) {
  new_board();
  dw1000_write_number(&hal, (enum dw1000_register)0x2F0000, 0, 1);
  dw1000_write_number(&hal, (enum dw1000_register)0x2F007F, 0, 2);
  dw1000_write_number(&hal, (enum dw1000_register)0x2F0080, 0, 3);
  (void)dw1000_read_number(&hal, (enum dw1000_register)0x2F27FF, 8);
  check_header(WRITE, 0x2F, 0, 1, "\xAF");
  check_header(WRITE, 0x2F, 0x7F, 2, "\xEF\x7F");
  check_header(WRITE, 0x2F, 0x80, 3, "\xEF\x80\x01");
  check_header(READ, 0x2F, 0x27FF, 8, "\x6F\xFF\x4F");
}

// ---- Start

static void the_lde_is_loaded_in_the_manuals_order(void) {
  new_board();
  CHECK_EQUAL(dw1000_start(&radio, &hal, &settings), DW1000_OK);
  const unsigned clocks = written(0, 0x36, 0, 0x0301);
  CHECK_EQUAL(written(0, 0x2D, 6, 0x8000), clocks + 1);
  CHECK_EQUAL(module.steps[clocks + 2].kind, WAIT);
  CHECK_WITHIN(module.steps[clocks + 2].value, 150, 1000);
  CHECK_EQUAL(written(0, 0x36, 0, 0x0200), clocks + 3);
  CHECK(clocks + 3 < first(FAST));
}

static void the_spi_is_fast_only_after_the_lock(void) {
  new_board();
  CHECK_EQUAL(dw1000_start(&radio, &hal, &settings), DW1000_OK);
  CHECK_EQUAL(first(SLOW), 0);
  unsigned lock = 0;
  while (module.steps[lock].kind != READ || module.steps[lock].file != 0x0F) ++lock;
  CHECK_EQUAL(module.steps[lock].value & 2, 2);
  CHECK(written(0, 0x24, 0, 4) < lock);  // the lock's detector is on
  CHECK(lock < first(FAST));
  CHECK(module.fast);
}

static void a_radio_without_lock_stays_slow_and_is_unstable(void) {
  new_board();
  module.never_locks = true;
  CHECK_EQUAL(dw1000_start(&radio, &hal, &settings), DW1000_UNSTABLE);
  CHECK_EQUAL(first(FAST), module.count);
}

static void nothing_on_the_bus_is_absent(void) {
  new_board();
  module.dead = true;
  CHECK_EQUAL(dw1000_start(&radio, &hal, &settings), DW1000_ABSENT);
  CHECK_EQUAL(dw1000_wake(&radio, &hal, &settings), DW1000_ABSENT);
}

static void a_sleeping_radio_is_found_by_a_start(void) {
  new_board();
  module.asleep = true;
  CHECK_EQUAL(dw1000_start(&radio, &hal, &settings), DW1000_OK);
}

static void channel_5_at_64_mhz_has_the_manuals_values(void) {
  begin();
  CHECK_EQUAL(get(&module, 0x01, 0, 8), 0x0102030405060708);
  CHECK_EQUAL(get(&module, 0x03, 0, 4), 0x1234ABCD);
  CHECK_EQUAL(get(&module, 0x04, 0, 4), 0x00001200);
  CHECK_EQUAL(get(&module, 0x08, 0, 5), 0x0016C000);
  CHECK_EQUAL(get(&module, 0x0E, 0, 4), 0x2437D080);
  CHECK_EQUAL(get(&module, 0x1E, 0, 4), 0x25456585);
  CHECK_EQUAL(get(&module, 0x1F, 0, 4), 0x4A480055);  // codes 9, PRF 64, channel 5
  CHECK_EQUAL(get(&module, 0x23, 0x04, 2), 0x889B);
  CHECK_EQUAL(get(&module, 0x23, 0x0C, 4), 0x2502A907);
  CHECK_EQUAL(get(&module, 0x23, 0x12, 2), 0x0035);
  CHECK_EQUAL(get(&module, 0x27, 0x02, 2), 0x0001);
  CHECK_EQUAL(get(&module, 0x27, 0x04, 2), 0x008D);
  CHECK_EQUAL(get(&module, 0x27, 0x06, 2), 0x0020);
  CHECK_EQUAL(get(&module, 0x27, 0x08, 4), 0x313B006B);
  CHECK_EQUAL(get(&module, 0x27, 0x20, 2), 129);
  CHECK_EQUAL(get(&module, 0x27, 0x26, 2), 0x0028);
  CHECK_EQUAL(get(&module, 0x28, 0x0B, 1), 0xD8);
  CHECK_EQUAL(get(&module, 0x28, 0x0C, 4), 0x001E3FE0);
  CHECK_EQUAL(get(&module, 0x2A, 0x0B, 1), 0xC0);
  CHECK_EQUAL(get(&module, 0x2B, 0x07, 4), 0x0800041D);
  CHECK_EQUAL(get(&module, 0x2B, 0x0B, 1), 0xBE);
  CHECK_EQUAL(get(&module, 0x2B, 0x0E, 1), 0x69);  // trim 9
  CHECK_EQUAL(get(&module, 0x2E, 0x0806, 1), 0x6D);
  CHECK_EQUAL(get(&module, 0x2E, 0x1806, 2), 0x0607);
  CHECK_EQUAL(get(&module, 0x2E, 0x2804, 2), 0x28F4);
  CHECK_EQUAL(get(&module, 0x36, 0, 2), 0x0200);
}

static void channel_2_at_16_mhz_has_the_manuals_values(void) {
  struct dw1000_settings other = settings;
  other.channel = 2;
  other.prf_mhz = 16;
  new_board();
  CHECK_EQUAL(dw1000_start(&radio, &hal, &other), DW1000_OK);
  CHECK_EQUAL(get(&module, 0x08, 0, 5), 0x0015C000);
  CHECK_EQUAL(get(&module, 0x1E, 0, 4), 0x15355575);
  CHECK_EQUAL(get(&module, 0x1F, 0, 4), 0x18C40022);  // codes 3, PRF 16, channel 2
  CHECK_EQUAL(get(&module, 0x23, 0x04, 2), 0x8870);
  CHECK_EQUAL(get(&module, 0x27, 0x04, 2), 0x0087);
  CHECK_EQUAL(get(&module, 0x27, 0x08, 4), 0x311A002D);
  CHECK_EQUAL(get(&module, 0x28, 0x0C, 4), 0x00045CA0);
  CHECK_EQUAL(get(&module, 0x2A, 0x0B, 1), 0xC2);
  CHECK_EQUAL(get(&module, 0x2B, 0x07, 4), 0x08400508);
  CHECK_EQUAL(get(&module, 0x2B, 0x0B, 1), 0x26);
  CHECK_EQUAL(get(&module, 0x2E, 0x1806, 2), 0x1607);
  CHECK_EQUAL(get(&module, 0x2E, 0x2804, 2), 0x51EA);
}

// UM 10.5: a code's PRF and channels.
static void every_channel_has_codes_that_exist_there(void) {
  static const struct {
    uint8_t channel;
    uint32_t codes_16, codes_64;  // bit i: code i
  } manual[] = {{1, 0x006, 0x1E00},   {2, 0x018, 0x1E00}, {3, 0x060, 0x1E00},
                {4, 0x180, 0x1E0000}, {5, 0x018, 0x1E00}, {7, 0x180, 0x1E0000}};
  CHECK_EQUAL(sizeof dw1000_channels / sizeof *dw1000_channels, 6);
  for (unsigned i = 0; i < 6; ++i) {
    CHECK_EQUAL(dw1000_channels[i].channel, manual[i].channel);
    CHECK(manual[i].codes_16 >> dw1000_channels[i].preamble_code[0] & 1);
    CHECK(manual[i].codes_64 >> dw1000_channels[i].preamble_code[1] & 1);
    CHECK_EQUAL(dw1000_channels[i].rf_rxctrlh,
                manual[i].codes_64 == 0x1E00 ? 0xD8 : 0xBC);  // 500 MHz, 900 MHz
  }
}

static void settings_that_do_not_exist_touch_nothing(void) {
  struct dw1000_settings bad[] = {settings, settings, settings};
  bad[0].channel = 6;
  bad[1].prf_mhz = 4;
  bad[2].antenna_delay = 0x1FFFF;
  for (unsigned i = 0; i < 3; ++i) {
    new_board();
    CHECK_EQUAL(dw1000_start(&radio, &hal, &bad[i]), DW1000_BAD_SETTING);
    CHECK_EQUAL(dw1000_wake(&radio, &hal, &bad[i]), DW1000_BAD_SETTING);
    CHECK_EQUAL(module.count, 0);
  }
}

static void antenna_delays_add_up_to_the_setting(void) {
  begin();
  static const uint32_t delays[] = {0, 1, 32900, 32901, 0x1FFFD, 0x1FFFE};
  for (unsigned i = 0; i < 6; ++i) {
    dw1000_set_antenna_delay(&radio, delays[i]);
    CHECK_EQUAL(get(&module, 0x18, 0, 2) + get(&module, 0x2E, 0x1804, 2), delays[i]);
    CHECK_EQUAL(dw1000_stamp_of(&radio, 0), get(&module, 0x18, 0, 2));
  }
  dw1000_set_antenna_delay(&radio, 0x20000);
  CHECK_EQUAL(get(&module, 0x18, 0, 2), 0xFFFF);
  CHECK_EQUAL(get(&module, 0x2E, 0x1804, 2), 0xFFFF);
}

static void the_factorys_ldo_tuning_is_loaded_where_there_is_one(void) {
  begin();
  CHECK(!radio.ldo_tuned);
  CHECK_EQUAL(get(&module, 0x2D, 0x12, 1), 0);
  new_board();
  module.otp[0x004] = 0x88888828;
  module.otp[0x01E] = 0;
  CHECK_EQUAL(dw1000_start(&radio, &hal, &settings), DW1000_OK);
  CHECK(radio.ldo_tuned);
  CHECK_EQUAL(get(&module, 0x2D, 0x12, 1), 2);
  CHECK_EQUAL(get(&module, 0x2B, 0x0E, 1), 0x70);  // no trim: the middle
}

// ---- Listening

static void listening_for_good_has_no_timeout(void) {
  begin();
  dw1000_listen(&radio, 0);
  CHECK_EQUAL(get(&module, 0x04, 0, 4), 0x00001200);
  CHECK_EQUAL(get(&module, 0x0D, 0, 2), 0x0100);
}

// Units of 512 / 499.2 MHz, rounded up.
static void a_timeout_is_at_least_as_long_as_asked_for(void) {
  static const struct {
    uint32_t us, units;
  } known[] = {{1, 1},      {40, 39},       {41, 40},       {1000, 975},
               {1001, 976}, {67000, 65325}, {67216, 65535}, {UINT32_MAX, 65535}};
  for (unsigned i = 0; i < sizeof known / sizeof *known; ++i) {
    begin();
    dw1000_listen(&radio, known[i].us);
    CHECK_EQUAL(get(&module, 0x0C, 0, 2), known[i].units);
    CHECK_EQUAL(get(&module, 0x04, 0, 4), 0x10001200);
  }
}

static void a_timeout_does_not_outlast_its_listening(void) {
  begin();
  dw1000_listen(&radio, 5000);
  dw1000_listen(&radio, 0);
  CHECK_EQUAL(get(&module, 0x04, 0, 4), 0x00001200);
  dw1000_listen(&radio, 5000);
  CHECK_EQUAL(dw1000_send_at(&radio, 0, (const uint8_t*)"x", 1, true), DW1000_OK);
  CHECK_EQUAL(get(&module, 0x04, 0, 4), 0x00001200);
}

static void what_an_earlier_listening_left_is_cleared_before_the_next(void) {
  begin();
  set_status(&module, UINT64_C(0x7FFFFFFFF) & ~(UINT64_C(1) << 27));
  dw1000_listen(&radio, 0);
  const unsigned off = written(0, 0x0D, 0, 0x40);
  CHECK(off < written(0, 0x0D, 0, 0x100));
  CHECK_EQUAL(dw1000_service(&radio, buffer).kind, DW1000_NOTHING);
  CHECK_EQUAL(get(&module, 0x0F, 0, 5) & 2, 2);  // the lock stays
}

// ---- Sending

static void a_frame_is_sent_at_its_moment_without_the_low_nine_bits(void) {
  begin();
  const uint8_t frame[] = {0x41, 0x88, 7};
  CHECK_EQUAL(dw1000_send_at(&radio, UINT64_C(0x89ABCDEFFF), frame, sizeof frame, true), DW1000_OK);
  CHECK_EQUAL(get(&module, 0x0A, 0, 5), 0x89ABCDEE00);
  CHECK_EQUAL(get(&module, 0x09, 0, 3), 0x078841);
  CHECK_EQUAL(get(&module, 0x08, 0, 5), 0x0016C005);  // with the FCS
  CHECK_EQUAL(get(&module, 0x0D, 0, 1), 0x86);
  CHECK(written(0, 0x0D, 0, 0x40) < written(0, 0x0D, 0, 0x86));
  CHECK_WITHIN(transfers(), 5, 8);
}

static void a_moment_beyond_40_bits_wraps(void) {
  begin();
  CHECK_EQUAL(dw1000_send_at(&radio, UINT64_C(0x10000000200), NULL, 0, false), DW1000_OK);
  CHECK_EQUAL(get(&module, 0x0A, 0, 5), 0x200);
  CHECK_EQUAL(get(&module, 0x0D, 0, 1), 0x06);
}

static void the_stamp_told_beforehand_is_the_antennas(void) {
  begin();  // 16450 of 32901 are the sender's
  CHECK_EQUAL(dw1000_stamp_of(&radio, 0x3FF), 0x200 + 16450);
  CHECK_EQUAL(dw1000_stamp_of(&radio, UINT64_C(0x8912345678)), UINT64_C(0x8912345600) + 16450);
  CHECK_EQUAL(dw1000_stamp_of(&radio, UINT64_C(0xFFFFFFFFFF)), 16450 - 0x200);
}

static void a_late_frame_is_cancelled(void) {
  for (int short_of_power = 0; short_of_power < 2; ++short_of_power) {
    begin();
    module.late = !short_of_power;
    module.too_short = short_of_power;
    CHECK_EQUAL(dw1000_send_at(&radio, 0x12345600, (const uint8_t*)"abc", 3, true), DW1000_TOO_LATE);
    const unsigned start = written(0, 0x0D, 0, 0x86);
    CHECK(written(start, 0x0D, 0, 0x40) < module.count);
    CHECK_EQUAL(get(&module, 0x36, 0, 1), 0);
    CHECK_EQUAL(get(&module, 0x0F, 0, 5), 2);
    CHECK_EQUAL(dw1000_service(&radio, buffer).kind, DW1000_NOTHING);
  }
}

// Errata 1.4, TX-1.
static void the_transmitters_clock_runs_while_a_delayed_frame_waits(void) {
  begin();
  (void)dw1000_send_at(&radio, 0x12345600, (const uint8_t*)"abc", 3, false);
  CHECK(written(0, 0x36, 0, 0x20) < written(0, 0x0D, 0, 0x06));
  CHECK_EQUAL(get(&module, 0x36, 0, 2), 0x0220);
  set_status(&module, 0xF0);
  (void)dw1000_service(&radio, buffer);
  CHECK_EQUAL(get(&module, 0x36, 0, 2), 0x0200);
  (void)dw1000_send_at(&radio, 0x12345600, (const uint8_t*)"abc", 3, false);
  dw1000_listen(&radio, 0);
  CHECK_EQUAL(get(&module, 0x36, 0, 2), 0x0200);
}

static void the_longest_frame_is_sent_and_a_longer_one_refused(void) {
  static const uint8_t frame[DW1000_MAX_FRAME + 1];
  begin();
  CHECK_EQUAL(dw1000_send_at(&radio, 0, frame, DW1000_MAX_FRAME, false), DW1000_OK);
  CHECK_EQUAL(get(&module, 0x08, 0, 1), 127);
  forget_steps();
  CHECK_EQUAL(dw1000_send_at(&radio, 0, frame, DW1000_MAX_FRAME + 1, false), DW1000_BAD_SETTING);
  CHECK_EQUAL(module.count, 0);
}

static void a_sent_frame_tells_its_stamp_and_only_its_own_bits_go(void) {
  begin();
  (void)dw1000_send_at(&radio, 0, (const uint8_t*)"abc", 3, true);
  put(&module, 0x17, 0, UINT64_C(0xFEDCBA9876), 5);
  receive((const uint8_t*)"answer", 6, 0x7FFFFFFFFF);
  set_status(&module, 0xF0);
  struct dw1000_event event = dw1000_service(&radio, buffer);
  CHECK_EQUAL(event.kind, DW1000_SENT);
  CHECK_EQUAL(event.stamp, 0xFEDCBA9876);
  CHECK_EQUAL(get(&module, 0x0F, 0, 5), 0x6F02);
  event = dw1000_service(&radio, buffer);
  CHECK_EQUAL(event.kind, DW1000_RECEIVED);
  CHECK_EQUAL(event.stamp, 0x7FFFFFFFFF);
  CHECK_EQUAL(get(&module, 0x0F, 0, 5), 2);
  CHECK_EQUAL(dw1000_service(&radio, buffer).kind, DW1000_NOTHING);
}

// ---- Receiving

static void a_frame_comes_with_stamp_power_and_clock(void) {
  begin();
  dw1000_listen(&radio, 0);
  receive((const uint8_t*)"hello", 5, UINT64_C(0xF123456789));
  put(&module, 0x14, 0, 0xAB0000E4, 4);  // what is above the offset is something else
  set_status(&module, UINT64_C(1) << 23);
  forget_steps();
  const struct dw1000_event event = dw1000_service(&radio, buffer);
  CHECK_EQUAL(event.kind, DW1000_RECEIVED);
  CHECK_EQUAL(event.size, 5);
  CHECK_EQUAL(memcmp(buffer, "hello", 5), 0);
  CHECK_EQUAL(event.stamp, 0xF123456789);
  CHECK_EQUAL(event.fp_power_cdbm, -7943);
  CHECK_EQUAL(event.rx_power_cdbm, -7516);
  CHECK_EQUAL(event.clock_ppb, 6848);  // 228 / 0x01FC0000
  CHECK_EQUAL(get(&module, 0x0F, 0, 5), 0x800002);
  CHECK_WITHIN(transfers(), 6, 8);
  CHECK_NOT_WRITTEN(0x36, 3, 0xE0);
}

// The manual's examples, UM 7.2.22: +7.014 and -5.045 ppm.
static void the_senders_clock_is_faster_where_the_offset_is_positive(void) {
  struct dw1000_settings prf_16 = settings;
  prf_16.prf_mhz = 16;
  new_board();
  CHECK_EQUAL(dw1000_start(&radio, &hal, &prf_16), DW1000_OK);
  receive((const uint8_t*)"a", 1, 0);
  put(&module, 0x14, 0, 0x000E4, 3);
  CHECK_EQUAL(dw1000_service(&radio, buffer).clock_ppb, 7014);
  receive((const uint8_t*)"a", 1, 0);
  put(&module, 0x14, 0, 0x7FF5C, 3);
  CHECK_EQUAL(dw1000_service(&radio, buffer).clock_ppb, -5045);
  receive((const uint8_t*)"a", 1, 0);
  put(&module, 0x14, 0, 0x40000, 3);  // -262144: no crystal is so far off
  CHECK_EQUAL(dw1000_service(&radio, buffer).clock_ppb, DW1000_UNKNOWN_CLOCK);
  receive((const uint8_t*)"a", 1, 0);
  put(&module, 0x14, 0, 0x3FFFF, 3);
  CHECK_EQUAL(dw1000_service(&radio, buffer).clock_ppb, DW1000_UNKNOWN_CLOCK);
}

static void a_frame_is_bounded_by_the_buffer(void) {
  static const struct {
    unsigned length;  // with the FCS
    enum dw1000_event_kind kind;
  } known[] = {{0, DW1000_BAD_RECEPTION}, {1, DW1000_BAD_RECEPTION},   {2, DW1000_RECEIVED},
               {127, DW1000_RECEIVED},    {128, DW1000_BAD_RECEPTION}, {1023, DW1000_BAD_RECEPTION}};
  for (unsigned i = 0; i < sizeof known / sizeof *known; ++i) {
    begin();
    memset(buffer, 0x5A, sizeof buffer);
    receive((const uint8_t*)"", 0, 0);
    put(&module, 0x10, 0, (uint64_t)120 << 20 | known[i].length, 4);
    const struct dw1000_event event = dw1000_service(&radio, buffer);
    CHECK_EQUAL(event.kind, known[i].kind);
    if (known[i].kind == DW1000_RECEIVED) {
      CHECK_EQUAL(event.size, known[i].length - 2);
    } else {
      check_reset_of_the_receiver();
    }
    CHECK_EQUAL(buffer[event.size], 0x5A);
    CHECK_EQUAL(get(&module, 0x0F, 0, 5), 2);
  }
}

static void every_error_resets_the_receiver(void) {
  static const unsigned errors[] = {12, 15, 16, 18, 20, 26, 29};
  for (unsigned i = 0; i < sizeof errors / sizeof *errors; ++i) {
    begin();
    dw1000_listen(&radio, 0);
    forget_steps();
    set_status(&module, 0x300 | UINT64_C(1) << errors[i]);
    CHECK_EQUAL(dw1000_service(&radio, buffer).kind, DW1000_BAD_RECEPTION);
    check_reset_of_the_receiver();
    CHECK_EQUAL(get(&module, 0x0F, 0, 5), 2);
    CHECK_EQUAL(dw1000_service(&radio, buffer).kind, DW1000_NOTHING);
  }
}

static void a_timeout_resets_the_receiver(void) {
  static const unsigned timeouts[] = {17, 21};
  for (unsigned i = 0; i < 2; ++i) {
    begin();
    dw1000_listen(&radio, 1000);
    forget_steps();
    set_status(&module, UINT64_C(1) << timeouts[i]);
    CHECK_EQUAL(dw1000_service(&radio, buffer).kind, DW1000_TIMED_OUT);
    check_reset_of_the_receiver();
    CHECK_EQUAL(get(&module, 0x0F, 0, 5), 2);
  }
}

static void a_frame_without_a_good_stamp_is_not_received(void) {
  static const uint64_t states[] = {0x6B00, 0x46F00};  // without LDEDONE; with LDEERR
  for (unsigned i = 0; i < 2; ++i) {
    begin();
    receive((const uint8_t*)"hello", 5, 1);
    put(&module, 0x0F, 0, states[i], 5);
    CHECK_EQUAL(dw1000_service(&radio, buffer).kind, DW1000_BAD_RECEPTION);
    check_reset_of_the_receiver();
    CHECK_EQUAL(get(&module, 0x0F, 0, 5), 0);
  }
}

// Whatever can raise the interrupt is handled, or it would stay up.
static void no_interrupt_stays(void) {
  begin();
  const uint64_t mask = get(&module, 0x0E, 0, 4);
  for (unsigned bit = 0; bit < 32; ++bit) {
    if ((mask >> bit & 1) == 0) continue;
    set_status(&module, UINT64_C(1) << bit);
    CHECK(dw1000_service(&radio, buffer).kind != DW1000_NOTHING);
    CHECK_EQUAL(get(&module, 0x0F, 0, 5) & mask, 0);
  }
}

static void a_bus_that_nothing_drives_says_nothing(void) {
  begin();
  module.dead = true;
  CHECK_EQUAL(dw1000_service(&radio, buffer).kind, DW1000_NOTHING);
}

static void no_answer_overruns_the_buffer(void) {
  begin();
  module.babbling = true;
  memset(buffer, 0x5A, sizeof buffer);
  unsigned kinds = 0;
  for (unsigned i = 0; i < 20000; ++i) {
    forget_steps();
    const struct dw1000_event event = dw1000_service(&radio, buffer);
    kinds |= 1u << event.kind;
    CHECK(event.size <= DW1000_MAX_FRAME);
    CHECK(event.stamp >> 40 == 0);
  }
  CHECK_EQUAL(kinds & 0x16, 0x16);  // SENT, RECEIVED, BAD_RECEPTION
  for (unsigned i = DW1000_MAX_FRAME; i < sizeof buffer; ++i) CHECK_EQUAL(buffer[i], 0x5A);
}

// ---- Time, temperature, sleep

static void now_has_all_40_bits(void) {
  begin();
  put(&module, 0x06, 0, UINT64_C(0xFEDCBA9800), 5);
  CHECK_EQUAL(dw1000_now(&radio), 0xFEDCBA9800);
}

static void temperature_is_told_from_the_factorys_measurement(void) {
  begin();  // 0x7B at 23 degrees
  put(&module, 0x2A, 4, 0x7B, 1);
  CHECK_EQUAL(dw1000_temperature_cc(&radio), 2300);
  put(&module, 0x2A, 4, 0x85, 1);
  CHECK_EQUAL(dw1000_temperature_cc(&radio), 3440);
  put(&module, 0x2A, 4, 0, 1);
  CHECK_EQUAL(dw1000_temperature_cc(&radio), 2300 - 123 * 114);
  CHECK_EQUAL(get(&module, 0x28, 0x11, 1), 0x80);
  CHECK(written(0, 0x28, 0x12, 0x0A) + 1 == written(0, 0x28, 0x12, 0x0F));
  CHECK(written(0, 0x2A, 0, 1) < first(WAIT));
  CHECK_EQUAL(get(&module, 0x2A, 0, 1), 0);
}

static void without_it_the_typical_sensor_is_taken(void) {
  new_board();
  module.otp[0x009] = 0;
  CHECK_EQUAL(dw1000_start(&radio, &hal, &settings), DW1000_OK);
  put(&module, 0x2A, 4, 120, 1);
  CHECK_EQUAL(dw1000_temperature_cc(&radio), 2300);
}

static void sleep_saves_everything_and_wakes_by_the_spi(void) {
  for (unsigned tuned = 0; tuned < 2; ++tuned) {
    new_board();
    module.otp[0x004] = tuned ? 0x28 : 0;
    CHECK_EQUAL(dw1000_start(&radio, &hal, &settings), DW1000_OK);
    dw1000_listen(&radio, 1000);
    set_status(&module, 0x20000);
    forget_steps();
    dw1000_sleep(&radio);
    CHECK_EQUAL(get(&module, 0x2C, 0, 2), tuned ? 0x1840 : 0x0840);
    CHECK_EQUAL(get(&module, 0x2C, 6, 1), 0x05);
    CHECK_EQUAL(get(&module, 0x04, 0, 4), 0x00001200);
    CHECK_EQUAL(get(&module, 0x0F, 0, 5), 2);  // no interrupt that keeps it awake
    CHECK_EQUAL(written(0, 0x2C, 2, 0), module.count - 2);
    CHECK_EQUAL(written(0, 0x2C, 2, 2), module.count - 1);
  }
}

// What deep sleep forgets, and what TX_ANTD becomes (UM 7.2.26).
static void fall_asleep(void) {
  dw1000_sleep(&radio);
  put(&module, 0x01, 0, 0, 8);
  put(&module, 0x18, 0, 0x40, 2);
  put(&module, 0x24, 0, 0, 4);
  module.asleep = true;
  memset(&radio, 0xA5, sizeof radio);  // nor does the board remember anything
  forget_steps();
}

static void waking_writes_what_sleep_forgot(void) {
  begin();
  fall_asleep();
  CHECK_EQUAL(dw1000_wake(&radio, &hal, &settings), DW1000_OK);
  CHECK_EQUAL(first(SLOW), 0);
  CHECK_EQUAL(first(SELECT), 1);
  CHECK_WITHIN(module.steps[1].value, 500, 2000);
  CHECK_WITHIN(module.steps[2].value, 3000, 10000);
  CHECK_EQUAL(first(RESET), module.count);
  CHECK(written(0, 0x24, 0, 4) < first(FAST));
  CHECK_EQUAL(get(&module, 0x01, 0, 8), 0x0102030405060708);
  CHECK_EQUAL(get(&module, 0x18, 0, 2), 16450);
  CHECK_EQUAL(get(&module, 0x2E, 0x1804, 2), 16451);
  CHECK_EQUAL(radio.temperature_at_23_c, 0x7B);
  CHECK(module.fast);
  CHECK_NOT_WRITTEN(0x2D, 6, 0x8000);  // the LDE was loaded on waking
  receive((const uint8_t*)"hello", 5, 1);
  CHECK_EQUAL(dw1000_service(&radio, buffer).rx_power_cdbm, -7516);
}

static void a_radio_that_lost_its_settings_is_started_anew(void) {
  begin();
  fall_asleep();
  put(&module, 0x1F, 0, 0x21040055, 4);  // the reset's value
  CHECK_EQUAL(dw1000_wake(&radio, &hal, &settings), DW1000_OK);
  CHECK(first(RESET) < module.count);
  CHECK_WRITTEN(0x2D, 6, 0x8000);
  CHECK_EQUAL(get(&module, 0x1F, 0, 4), 0x4A480055);
}

static void a_radio_with_another_address_is_started_anew(void) {
  begin();
  fall_asleep();
  struct dw1000_settings other = settings;
  other.address = 1;
  CHECK_EQUAL(dw1000_wake(&radio, &hal, &other), DW1000_OK);
  CHECK(first(RESET) < module.count);
  CHECK_EQUAL(get(&module, 0x03, 0, 4), 0x12340001);
}

static void a_radio_that_did_not_sleep_works_too(void) {
  begin();
  (void)dw1000_send_at(&radio, 0x1000, (const uint8_t*)"abc", 3, true);
  CHECK_EQUAL(dw1000_wake(&radio, &hal, &settings), DW1000_OK);
  CHECK_EQUAL(get(&module, 0x36, 0, 1), 0);
  dw1000_listen(&radio, 1000);
  receive((const uint8_t*)"old", 3, 1);
  CHECK_EQUAL(dw1000_wake(&radio, &hal, &settings), DW1000_OK);
  CHECK_EQUAL(get(&module, 0x04, 0, 4), 0x00001200);
  CHECK_EQUAL(dw1000_service(&radio, buffer).kind, DW1000_NOTHING);
  CHECK(module.fast);
}

int main(void) {
  headers_are_those_of_the_manual();
  an_index_takes_the_bytes_it_needs();
  the_lde_is_loaded_in_the_manuals_order();
  the_spi_is_fast_only_after_the_lock();
  a_radio_without_lock_stays_slow_and_is_unstable();
  nothing_on_the_bus_is_absent();
  a_sleeping_radio_is_found_by_a_start();
  channel_5_at_64_mhz_has_the_manuals_values();
  channel_2_at_16_mhz_has_the_manuals_values();
  every_channel_has_codes_that_exist_there();
  settings_that_do_not_exist_touch_nothing();
  antenna_delays_add_up_to_the_setting();
  the_factorys_ldo_tuning_is_loaded_where_there_is_one();
  listening_for_good_has_no_timeout();
  a_timeout_is_at_least_as_long_as_asked_for();
  a_timeout_does_not_outlast_its_listening();
  what_an_earlier_listening_left_is_cleared_before_the_next();
  a_frame_is_sent_at_its_moment_without_the_low_nine_bits();
  a_moment_beyond_40_bits_wraps();
  the_stamp_told_beforehand_is_the_antennas();
  a_late_frame_is_cancelled();
  the_transmitters_clock_runs_while_a_delayed_frame_waits();
  the_longest_frame_is_sent_and_a_longer_one_refused();
  a_sent_frame_tells_its_stamp_and_only_its_own_bits_go();
  a_frame_comes_with_stamp_power_and_clock();
  the_senders_clock_is_faster_where_the_offset_is_positive();
  a_frame_is_bounded_by_the_buffer();
  every_error_resets_the_receiver();
  a_timeout_resets_the_receiver();
  a_frame_without_a_good_stamp_is_not_received();
  no_interrupt_stays();
  a_bus_that_nothing_drives_says_nothing();
  no_answer_overruns_the_buffer();
  now_has_all_40_bits();
  temperature_is_told_from_the_factorys_measurement();
  without_it_the_typical_sensor_is_taken();
  sleep_saves_everything_and_wakes_by_the_spi();
  waking_writes_what_sleep_forgot();
  a_radio_that_lost_its_settings_is_started_anew();
  a_radio_with_another_address_is_started_anew();
  a_radio_that_did_not_sleep_works_too();
  return check_verdict();
}
