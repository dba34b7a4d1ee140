// The HAL upon a pretended ESP-IDF: what is on the wires, and when.
#include <string.h>

#include "driver/gpio.h"
#include "esp_random.h"
#include "esp_rom_sys.h"
#include "firmware/tests/check.h"
#include "hal_esp.h"
#include "sdkconfig.h"

#define CS CONFIG_SYNCHRONIZAR_CS_GPIO
#define RST CONFIG_SYNCHRONIZAR_RST_GPIO
#define IRQ CONFIG_SYNCHRONIZAR_IRQ_GPIO
#define PINS 40
#define TASK ((TaskHandle_t)(uintptr_t)0x7A5C)

struct spi_device_t {
  int hz;
  bool has_bus;
};

static struct {
  int level[PINS];
  gpio_mode_t mode[PINS];
  bool held[PINS], edge[PINS];
  gpio_isr_t handler;
  void* handler_context;
  esp_timer_create_args_t timer;
  struct spi_device_t device[2];
  int devices;
  uint64_t now_us;                 // moves only by delays
  uint64_t selected_us, reset_us;  // how long these were low
  int selections, transfers;
  int hz;            // of the latest transfer
  size_t most_bits;  // of any transfer
  uint8_t mosi[512];
  size_t clocked;  // bytes since chip select fell
  int notified, yields;
  uint64_t armed_us;
  int armings, stops, takes;
} esp;

static void expect(bool true_thing, const char* what) { check_equal(true_thing, 1, what, __FILE__, 0); }

// The radio's answer: each byte tells its place since chip select fell.
static uint8_t miso(size_t place) { return (uint8_t)(place * 7 + 3); }

esp_err_t gpio_set_level(gpio_num_t pin, uint32_t level) {
  if (pin == CS && esp.level[CS] == 1 && level == 0) esp.selections++, esp.clocked = 0;
  esp.level[pin] = (int)level;
  return ESP_OK;
}

int gpio_get_level(gpio_num_t pin) { return esp.level[pin]; }

esp_err_t gpio_config(const gpio_config_t* config) {
  for (int pin = 0; pin < PINS; ++pin) {
    if ((config->pin_bit_mask >> pin & 1) == 0) continue;
    esp.mode[pin] = config->mode;
    esp.edge[pin] = config->intr_type == GPIO_INTR_POSEDGE;
    if (config->mode != GPIO_MODE_INPUT) expect(esp.level[pin] == 1, "an output begins high, or let go");
  }
  return ESP_OK;
}

esp_err_t gpio_install_isr_service(int flags) { return flags == ESP_INTR_FLAG_IRAM ? ESP_OK : ESP_FAIL; }

esp_err_t gpio_isr_handler_add(gpio_num_t pin, gpio_isr_t handler, void* context) {
  expect(pin == IRQ, "the interrupt is the radio's");
  esp.handler = handler;
  esp.handler_context = context;
  return ESP_OK;
}

esp_err_t gpio_hold_en(gpio_num_t pin) {
  expect(esp.level[pin] == 1, "held high, or let go");
  esp.held[pin] = true;
  return ESP_OK;
}

esp_err_t gpio_hold_dis(gpio_num_t pin) {
  expect(esp.mode[pin] != GPIO_MODE_INPUT && esp.level[pin] == 1, "a hold ends once the pin is as it was");
  esp.held[pin] = false;
  return ESP_OK;
}

void gpio_deep_sleep_hold_en(void) {}
void gpio_deep_sleep_hold_dis(void) {}

esp_err_t spi_bus_initialize(spi_host_device_t host, const spi_bus_config_t* bus, spi_dma_chan_t dma) {
  expect(bus->sclk_io_num == 18 && bus->miso_io_num == 19 && bus->mosi_io_num == 23, "pins of the bus");
  return host == SPI3_HOST && dma == SPI_DMA_DISABLED ? ESP_OK : ESP_FAIL;
}

esp_err_t spi_bus_add_device(spi_host_device_t host, const spi_device_interface_config_t* config,
                             spi_device_handle_t* handle) {
  expect(config->mode == 0 && config->spics_io_num == -1, "mode 0, chip select our own");
  struct spi_device_t* device = &esp.device[esp.devices++];
  device->hz = config->clock_speed_hz;
  *handle = device;
  return host == SPI3_HOST ? ESP_OK : ESP_FAIL;
}

esp_err_t spi_device_acquire_bus(spi_device_handle_t device, TickType_t wait) {
  expect(wait == portMAX_DELAY && !esp.device[0].has_bus && !esp.device[1].has_bus, "the bus is free");
  device->has_bus = true;
  return ESP_OK;
}

void spi_device_release_bus(spi_device_handle_t device) { device->has_bus = false; }

esp_err_t spi_device_polling_transmit(spi_device_handle_t device, spi_transaction_t* transaction) {
  const size_t bytes = transaction->length / 8;
  expect(transaction->length % 8 == 0 && bytes > 0 && transaction->tx_buffer != NULL, "a transfer of bytes");
  expect(esp.level[CS] == 0, "selected while the clock runs");
  expect(device->has_bus, "whoever transfers has the bus");
  esp.transfers++;
  esp.hz = device->hz;
  if (transaction->length > esp.most_bits) esp.most_bits = transaction->length;
  memcpy(esp.mosi + esp.clocked, transaction->tx_buffer, bytes);
  for (size_t i = 0; transaction->rx_buffer != NULL && i < bytes; ++i)
    ((uint8_t*)transaction->rx_buffer)[i] = miso(esp.clocked + i);
  esp.clocked += bytes;
  return ESP_OK;
}

void esp_rom_delay_us(uint32_t us) {
  esp.now_us += us;
  if (esp.level[CS] == 0) esp.selected_us += us;
  if (esp.level[RST] == 0) esp.reset_us += us;
}

// A delay by ticks ends with the tick: as little as possible of its first one has passed.
void vTaskDelay(TickType_t ticks) { esp_rom_delay_us((ticks - 1) * 1000); }

esp_err_t esp_timer_create(const esp_timer_create_args_t* settings, esp_timer_handle_t* timer) {
  expect(settings->dispatch_method == ESP_TIMER_ISR, "deadlines come from the timer's interrupt");
  esp.timer = *settings;
  *timer = (esp_timer_handle_t)&esp.timer;
  return ESP_OK;
}

esp_err_t esp_timer_start_once(esp_timer_handle_t timer, uint64_t us) {
  (void)timer;
  esp.armings++;
  esp.armed_us = us;
  return ESP_OK;
}

esp_err_t esp_timer_stop(esp_timer_handle_t timer) {
  (void)timer;
  esp.stops++;
  return ESP_FAIL;  // as when it has fired already
}

int64_t esp_timer_get_time(void) { return (int64_t)esp.now_us; }
void esp_timer_isr_dispatch_need_yield(void) { esp.yields++; }
void vPortYieldFromISR(void) { esp.yields++; }

void vTaskNotifyGiveFromISR(TaskHandle_t task, BaseType_t* woken) {
  expect(task == TASK, "the ranging task is notified");
  esp.notified++;
  *woken = pdTRUE;
}

uint32_t ulTaskNotifyTake(BaseType_t clear, TickType_t ticks) {
  expect(clear == pdTRUE && ticks == BOARD_PATIENCE_MS, "it waits, but not for good");
  esp.takes++;
  return 1;
}

TaskHandle_t xTaskGetCurrentTaskHandle(void) { return TASK; }
uint32_t esp_random(void) { return 4; }

bool network_send(const struct network* network, const uint8_t* datagram, size_t size) {
  return network == NULL && datagram[0] == 9 && size == 1;
}

static struct board board;

static void start(void) {
  memset(&esp, 0, sizeof esp);
  board_start(&board, NULL);
}

static void pins_are_as_the_radio_wants_them(void) {
  start();
  CHECK_EQUAL(esp.mode[CS], GPIO_MODE_OUTPUT);
  CHECK_EQUAL(esp.level[CS], 1);
  CHECK_EQUAL(esp.mode[RST], GPIO_MODE_OUTPUT_OD);
  CHECK_EQUAL(esp.level[RST], 1);
  CHECK_EQUAL(esp.mode[IRQ], GPIO_MODE_INPUT);
  CHECK(esp.edge[IRQ]);
}

static void a_register_is_read_in_one_transfer(void) {
  start();
  const uint8_t header[] = {0x51, 0x06};
  uint8_t data[5];
  board.hal.spi_read(&board, header, sizeof header, data, sizeof data);
  CHECK_EQUAL(esp.transfers, 1);
  CHECK_EQUAL(esp.clocked, 7);
  CHECK_EQUAL(memcmp(esp.mosi, header, sizeof header), 0);
  for (size_t i = 0; i < sizeof data; ++i) CHECK_EQUAL(data[i], miso(2 + i));
  CHECK_EQUAL(esp.level[CS], 1);
}

static void transfers_of_any_size_are_one_selection(void) {
  for (size_t header_size = 1; header_size <= 3; ++header_size) {
    for (size_t size = 0; size <= 127; ++size) {
      start();
      const uint8_t header[] = {0x91, 0x82, 0x73};
      uint8_t data[127], read[127];
      for (size_t i = 0; i < sizeof data; ++i) data[i] = (uint8_t)(i * 5 + 1);
      board.hal.spi_write(&board, header, header_size, data, size);
      CHECK_EQUAL(esp.clocked, header_size + size);
      CHECK_EQUAL(memcmp(esp.mosi, header, header_size), 0);
      CHECK_EQUAL(memcmp(esp.mosi + header_size, data, size), 0);
      CHECK_EQUAL(esp.selections, 1);
      board.hal.spi_read(&board, header, header_size, read, size);
      CHECK_EQUAL(esp.clocked, header_size + size);
      for (size_t i = 0; i < size; ++i) CHECK_EQUAL(read[i], miso(header_size + i));
      CHECK_EQUAL(esp.selections, 2);
      CHECK_EQUAL(esp.level[CS], 1);
      CHECK_WITHIN(esp.most_bits, 8, 8 * 64);  // the SPI's buffer
    }
  }
}

static void it_is_slow_until_told_to_be_fast(void) {
  start();
  const uint8_t header = 0;
  uint8_t id[4];
  board.hal.spi_read(&board, &header, 1, id, sizeof id);
  CHECK_EQUAL(esp.hz, 2000000);
  for (int i = 0; i < 2; ++i) board.hal.spi_fast(&board, true);
  board.hal.spi_read(&board, &header, 1, id, sizeof id);
  CHECK_EQUAL(esp.hz, 20000000);
  board.hal.spi_fast(&board, false);
  board.hal.spi_read(&board, &header, 1, id, sizeof id);
  CHECK_EQUAL(esp.hz, 2000000);
}

static void reset_and_wake_last_as_long_as_they_must(void) {
  start();
  board.hal.reset(&board);
  CHECK_WITHIN(esp.reset_us, 1, 1000);
  CHECK_EQUAL(esp.level[RST], 1);
  board.hal.select_for(&board, 600);
  CHECK_EQUAL(esp.selected_us, 600);
  CHECK_EQUAL(esp.level[CS], 1);
  CHECK_EQUAL(esp.transfers, 0);
}

static void waits_are_never_too_short(void) {
  const uint32_t lengths[] = {0, 1, 150, 1999, 2000, 2001, 3000, 3001, 10000};
  for (size_t i = 0; i < sizeof lengths / sizeof lengths[0]; ++i) {
    start();
    board.hal.wait(&board, lengths[i]);
    CHECK_WITHIN(esp.now_us, lengths[i], lengths[i] + 2000);
  }
}

static void an_interrupt_only_notifies(void) {
  start();
  esp.handler(esp.handler_context);
  CHECK_EQUAL(esp.notified, 1);
  CHECK_EQUAL(esp.yields, 1);
  esp.timer.callback(esp.timer.arg);
  CHECK_EQUAL(esp.notified, 2);
  CHECK_EQUAL(esp.yields, 2);
  CHECK_EQUAL(esp.transfers, 0);
  CHECK_EQUAL(esp.selections, 0);
}

static void the_task_waits_for_the_deadline_to_the_microsecond(void) {
  start();
  esp.now_us = 5000000000;  // past 32 bits
  board_wait(&board, esp.now_us + 731);
  CHECK_EQUAL(esp.armed_us, 731);
  CHECK_EQUAL(esp.takes, 1);
  CHECK_EQUAL(esp.stops, 1);
}

static void the_task_does_not_wait_where_there_is_something_to_do(void) {
  start();
  esp.now_us = 1000;
  board_wait(&board, 1000);
  board_wait(&board, 0);
  esp.level[IRQ] = 1;
  board_wait(&board, UINT64_MAX);
  CHECK_EQUAL(esp.takes, 0);
  CHECK_EQUAL(esp.armings, 0);
}

static void a_far_deadline_needs_no_timer(void) {
  start();
  board_wait(&board, UINT64_MAX);
  CHECK_EQUAL(esp.takes, 1);
  CHECK_EQUAL(esp.armings, 0);
  CHECK_EQUAL(esp.stops, 0);
}

static void pins_are_held_while_the_board_sleeps(void) {
  start();
  board_hold();
  CHECK(esp.held[CS]);
  CHECK(esp.held[RST]);
}

static void the_rest_is_handed_through(void) {
  start();
  const uint8_t datagram = 9;
  CHECK(board.hal.send(&board, &datagram, 1));
  CHECK_EQUAL(board.hal.random(&board), 4);
  esp.now_us = 42;
  CHECK_EQUAL(board.hal.now_us(&board), 42);
  CHECK(!board.hal.interrupted(&board));
  esp.level[IRQ] = 1;
  CHECK(board.hal.interrupted(&board));
}

int main(void) {
  pins_are_as_the_radio_wants_them();
  a_register_is_read_in_one_transfer();
  transfers_of_any_size_are_one_selection();
  it_is_slow_until_told_to_be_fast();
  reset_and_wake_last_as_long_as_they_must();
  waits_are_never_too_short();
  an_interrupt_only_notifies();
  the_task_waits_for_the_deadline_to_the_microsecond();
  the_task_does_not_wait_where_there_is_something_to_do();
  a_far_deadline_needs_no_timer();
  pins_are_held_while_the_board_sleeps();
  the_rest_is_handed_through();
  return check_verdict();
}
