#include "dw1000_spi.h"

#include "bytes.h"

#define WRITE 0x80u
#define SUB_INDEX 0x40u
#define EXTENDED 0x80u
#define HEADER_MAX 3u

// Index 0 needs one byte, up to 7F two, up to 7FFF three.
static size_t header_of(enum dw1000_register at, uint8_t operation, uint8_t header[HEADER_MAX]) {
  const unsigned file = (unsigned)at >> 16;
  const unsigned index = (unsigned)at & 0x7FFF;
  header[0] = (uint8_t)(operation | file);
  if (index == 0) return 1;
  header[0] |= SUB_INDEX;
  header[1] = (uint8_t)(index & 0x7F);
  if (index < 0x80) return 2;
  header[1] |= EXTENDED;
  header[2] = (uint8_t)(index >> 7);
  return 3;
}

void dw1000_read(const struct hal* hal, enum dw1000_register from, uint8_t* data, size_t size) {
  uint8_t header[HEADER_MAX];
  const size_t header_size = header_of(from, 0, header);
  hal->spi_read(hal->board, header, header_size, data, size);
}

void dw1000_write(const struct hal* hal, enum dw1000_register to, const uint8_t* data, size_t size) {
  uint8_t header[HEADER_MAX];
  const size_t header_size = header_of(to, WRITE, header);
  hal->spi_write(hal->board, header, header_size, data, size);
}

uint64_t dw1000_read_number(const struct hal* hal, enum dw1000_register from, size_t size) {
  uint8_t bytes[8] = {0};
  dw1000_read(hal, from, bytes, size);
  return bytes_get(bytes, size);
}

void dw1000_write_number(const struct hal* hal, enum dw1000_register to, uint64_t value, size_t size) {
  uint8_t bytes[8];
  bytes_put(bytes, value, sizeof bytes);
  dw1000_write(hal, to, bytes, size);
}
