#include "provisioning.h"

#include <stdio.h>
#include <string.h>

#include "command.h"
#include "driver/uart.h"
#include "esp_console.h"
#include "esp_err.h"
#include "esp_system.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "sdkconfig.h"
#include "store.h"

#define UART ((uart_port_t)CONFIG_ESP_CONSOLE_UART_NUM)
#define LINE_SIZE 320  // the longest command has 223 characters, quotes and escapes besides
#define STACK_BYTES 4096
#define PRIORITY 2
#define CORE 0

// The driver keeps what comes in while the task is away; the bare hardware keeps 128 characters, less than a
// line.
static void start_uart(void) { ESP_ERROR_CHECK(uart_driver_install(UART, 2 * LINE_SIZE, 0, 0, NULL, 0)); }

// Returns once a line has come that fits; longer ones are nothing that we know.
static void read_line(char line[LINE_SIZE]) {
  size_t size = 0;
  for (;;) {
    char c = '\0';
    if (uart_read_bytes(UART, &c, 1, portMAX_DELAY) != 1) continue;
    const bool ends = c == '\r' || c == '\n';
    if (!ends) {
      if (size < LINE_SIZE) line[size] = c;
      size += size < LINE_SIZE ? 1 : 0;
    } else if (size > 0 && size < LINE_SIZE) {
      line[size] = '\0';
      return;
    } else {
      size = 0;
    }
  }
}

static bool obey(char* line) {
  char* words[COMMAND_WORDS +
              2];  // esp_console ends them with NULL; one more than the longest, to notice what is too much
  const size_t count = esp_console_split_argv(line, words, COMMAND_WORDS + 2);
  struct store_provision provision;
  if (command_read_provision(count, words, &provision)) return store_write_provision(&provision);
  struct calibration calibration = store_read_calibration();
  if (command_read_calibration(count, words, &calibration) ||
      command_correct_calibration(count, words, &calibration))
    return store_write_calibration(&calibration);
  return false;
}

static void listen(void* context) {
  (void)context;
  char line[LINE_SIZE];
  for (;;) {
    read_line(line);
    if (obey(line)) {
      printf("kept; restarting\n");
      esp_restart();
    }
    memset(line, 0, sizeof line);
    printf(
        "not understood, or not kept: provision SESSION ADDRESS KEY SSID PASSWORD COLLECTOR\n"
        "                             calibrate DELAY TEMPERATURE SIGMA\n"
        "                             correct MEASURED TRUE\n");
  }
}

void provisioning_start(void) {
  start_uart();
  const BaseType_t made = xTaskCreatePinnedToCore(listen, "console", STACK_BYTES, NULL, PRIORITY, NULL, CORE);
  ESP_ERROR_CHECK(made == pdPASS ? ESP_OK : ESP_ERR_NO_MEM);
}
