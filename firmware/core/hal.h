// All that the core needs of a board. A target fills one of these; nothing else of the board is known above
// it.
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct hal {
  void* board;  // given back to every function below

  // One SPI transaction each: chip select is low from the header's first byte to the last byte of data.
  void (*spi_write)(void* board, const uint8_t* header, size_t header_size, const uint8_t* data, size_t size);
  void (*spi_read)(void* board, const uint8_t* header, size_t header_size, uint8_t* data, size_t size);
  // False: at most 3 MHz, all that the radio takes before its PLL has locked; true: up to 20 MHz.
  void (*spi_fast)(void* board, bool fast);

  void (*reset)(void* board);                    // pulls the radio's RSTn low and lets it go
  void (*select_for)(void* board, uint32_t us);  // holds chip select low without a clock: wakes the radio
  void (*wait)(void* board, uint32_t us);        // at least so long
  bool (*interrupted)(void* board);              // level of the radio's interrupt line
  uint64_t (*now_us)(void* board);               // the board's own clock; never goes back while it has power
  uint32_t (*random)(void* board);               // different on every board and at every start

  // Hands a datagram to the network; false: no room for it now, or no network.
  bool (*send)(void* board, const uint8_t* datagram, size_t size);
};
