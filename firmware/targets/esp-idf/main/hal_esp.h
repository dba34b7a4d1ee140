// The core's HAL on an ESP32, and how the ranging task waits.
#pragma once

#include <stdint.h>

#include "driver/spi_master.h"
#include "esp_timer.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "hal.h"
#include "network.h"

struct board {
  struct network* network;
  spi_device_handle_t slow, fast;
  spi_device_handle_t spi;  // which of the two is in use, and has the bus
  esp_timer_handle_t timer;
  TaskHandle_t task;  // whom interrupts notify
  struct hal hal;
};

// To be called by the task that will range, on its core: that is where the interrupt goes.
void board_start(struct board* board, struct network* network);

// Returns when the radio's interrupt line is high, at the deadline (us, board clock), when notified, and
// after BOARD_PATIENCE_MS, so that the watchdog can be fed.
#define BOARD_PATIENCE_MS 1000
void board_wait(struct board* board, uint64_t deadline_us);

// Holds chip select high and reset released while the board sleeps.
void board_hold(void);
