#include "hal_esp.h"

#include <string.h>

#include "driver/gpio.h"
#include "esp_attr.h"
#include "esp_err.h"
#include "esp_random.h"
#include "esp_rom_sys.h"
#include "sdkconfig.h"

#define CS ((gpio_num_t)CONFIG_SYNCHRONIZAR_CS_GPIO)
#define RST ((gpio_num_t)CONFIG_SYNCHRONIZAR_RST_GPIO)
#define IRQ ((gpio_num_t)CONFIG_SYNCHRONIZAR_IRQ_GPIO)

#define SLOW_HZ (2 * 1000 * 1000)
#define FAST_HZ (20 * 1000 * 1000)
#define RESET_US 50           // the radio asks for 10 ns (DS 2.12)
#define LONGEST_BUSY_US 2000  // longer waits leave the core to others

// The SPI's own buffer. Transfers without DMA have no set-up, no rules of alignment and no bounce buffers
// from the heap: for a register of a few bytes they are the quickest. Chip select is a plain output, so a
// frame may come in pieces.
#define PIECE 64

static size_t at_most(size_t size, size_t room) { return size < room ? size : room; }

static void transact(const struct board* board, const uint8_t* header, size_t header_size, const uint8_t* out,
                     uint8_t* in, size_t size) {
  uint8_t piece[PIECE];
  memcpy(piece, header, header_size);
  size_t used = header_size;
  size_t done = 0;
  ESP_ERROR_CHECK(gpio_set_level(CS, 0));
  do {
    const size_t part = at_most(size - done, PIECE - used);
    if (out != NULL)
      memcpy(piece + used, out + done, part);
    else
      memset(piece + used, 0, part);
    spi_transaction_t transaction = {
        .length = 8 * (used + part), .tx_buffer = piece, .rx_buffer = in != NULL ? piece : NULL};
    ESP_ERROR_CHECK(spi_device_polling_transmit(board->spi, &transaction));
    if (in != NULL) memcpy(in + done, piece + used, part);
    done += part;
    used = 0;
  } while (done < size);
  ESP_ERROR_CHECK(gpio_set_level(CS, 1));
}

static void spi_write(void* board, const uint8_t* header, size_t header_size, const uint8_t* data,
                      size_t size) {
  transact(board, header, header_size, data, NULL, size);
}

static void spi_read(void* board, const uint8_t* header, size_t header_size, uint8_t* data, size_t size) {
  transact(board, header, header_size, NULL, data, size);
}

static void spi_fast(void* context, bool fast) {
  struct board* board = context;
  spi_device_handle_t wanted = fast ? board->fast : board->slow;
  if (wanted == board->spi) return;
  // Whoever has acquired the bus polls without taking its lock each time.
  spi_device_release_bus(board->spi);
  ESP_ERROR_CHECK(spi_device_acquire_bus(wanted, portMAX_DELAY));
  board->spi = wanted;
}

static void wait_for(void* board, uint32_t us) {
  (void)board;
  if (us <= LONGEST_BUSY_US) {
    esp_rom_delay_us(us);
  } else {
    vTaskDelay(pdMS_TO_TICKS(us / 1000 + 1) + 1);  // the tick that has begun does not count
  }
}

static void reset(void* board) {
  ESP_ERROR_CHECK(gpio_set_level(RST, 0));
  wait_for(board, RESET_US);
  ESP_ERROR_CHECK(gpio_set_level(RST, 1));
}

static void select_for(void* board, uint32_t us) {
  ESP_ERROR_CHECK(gpio_set_level(CS, 0));
  wait_for(board, us);
  ESP_ERROR_CHECK(gpio_set_level(CS, 1));
}

static bool interrupted(void* board) {
  (void)board;
  return gpio_get_level(IRQ) != 0;
}

static uint64_t now_us(void* board) {
  (void)board;
  return (uint64_t)esp_timer_get_time();
}

static uint32_t random_number(void* board) {
  (void)board;
  return esp_random();
}

static bool send_datagram(void* context, const uint8_t* datagram, size_t size) {
  const struct board* board = context;
  return network_send(board->network, datagram, size);
}

// Interrupts only notify: SPI belongs to the task.
static void IRAM_ATTR on_interrupt(void* context) {
  const struct board* board = context;
  BaseType_t woken = pdFALSE;
  vTaskNotifyGiveFromISR(board->task, &woken);
  portYIELD_FROM_ISR(woken);
}

static void IRAM_ATTR on_timer(void* context) {
  const struct board* board = context;
  BaseType_t woken = pdFALSE;
  vTaskNotifyGiveFromISR(board->task, &woken);
  if (woken == pdTRUE) esp_timer_isr_dispatch_need_yield();
}

static void start_pins(struct board* board) {
  // Levels first, so that becoming an output changes nothing; a hold from before the sleep ends after that.
  ESP_ERROR_CHECK(gpio_set_level(CS, 1));
  ESP_ERROR_CHECK(gpio_set_level(RST, 1));
  const gpio_config_t select = {.pin_bit_mask = UINT64_C(1) << CS, .mode = GPIO_MODE_OUTPUT};
  const gpio_config_t let_go = {.pin_bit_mask = UINT64_C(1) << RST, .mode = GPIO_MODE_OUTPUT_OD};
  const gpio_config_t line = {
      .pin_bit_mask = UINT64_C(1) << IRQ, .mode = GPIO_MODE_INPUT, .intr_type = GPIO_INTR_POSEDGE};
  ESP_ERROR_CHECK(gpio_config(&select));
  ESP_ERROR_CHECK(gpio_config(&let_go));
  ESP_ERROR_CHECK(gpio_config(&line));
  gpio_deep_sleep_hold_dis();
  ESP_ERROR_CHECK(gpio_hold_dis(CS));
  ESP_ERROR_CHECK(gpio_hold_dis(RST));
  ESP_ERROR_CHECK(gpio_install_isr_service(ESP_INTR_FLAG_IRAM));
  ESP_ERROR_CHECK(gpio_isr_handler_add(IRQ, on_interrupt, board));
}

static void start_spi(struct board* board) {
  const spi_bus_config_t bus = {.sclk_io_num = CONFIG_SYNCHRONIZAR_SCLK_GPIO,
                                .miso_io_num = CONFIG_SYNCHRONIZAR_MISO_GPIO,
                                .mosi_io_num = CONFIG_SYNCHRONIZAR_MOSI_GPIO,
                                .quadwp_io_num = -1,
                                .quadhd_io_num = -1};
  ESP_ERROR_CHECK(spi_bus_initialize(SPI3_HOST, &bus, SPI_DMA_DISABLED));
  // Chip select is ours: two devices cannot share the driver's.
  spi_device_interface_config_t device = {
      .mode = 0, .clock_speed_hz = SLOW_HZ, .spics_io_num = -1, .queue_size = 1};
  ESP_ERROR_CHECK(spi_bus_add_device(SPI3_HOST, &device, &board->slow));
  device.clock_speed_hz = FAST_HZ;
  ESP_ERROR_CHECK(spi_bus_add_device(SPI3_HOST, &device, &board->fast));
  ESP_ERROR_CHECK(spi_device_acquire_bus(board->slow, portMAX_DELAY));
  board->spi = board->slow;
}

void board_start(struct board* board, struct network* network) {
  *board = (struct board){.network = network, .task = xTaskGetCurrentTaskHandle()};
  board->hal = (struct hal){.board = board,
                            .spi_write = spi_write,
                            .spi_read = spi_read,
                            .spi_fast = spi_fast,
                            .reset = reset,
                            .select_for = select_for,
                            .wait = wait_for,
                            .interrupted = interrupted,
                            .now_us = now_us,
                            .random = random_number,
                            .send = send_datagram};
  start_pins(board);
  start_spi(board);
  // From its interrupt: a tick of FreeRTOS is as long as a slot, and a timer task would stand behind Wi-Fi.
  const esp_timer_create_args_t timer = {
      .callback = on_timer, .arg = board, .dispatch_method = ESP_TIMER_ISR, .name = "deadline"};
  ESP_ERROR_CHECK(esp_timer_create(&timer, &board->timer));
}

void board_wait(struct board* board, uint64_t deadline_us) {
  const uint64_t now = now_us(board);
  // The interrupt is by edge: a line that is still high gives no other.
  if (deadline_us <= now || interrupted(board)) return;
  const uint64_t left_us = deadline_us - now;
  const bool soon = left_us < BOARD_PATIENCE_MS * UINT64_C(1000);
  if (soon) ESP_ERROR_CHECK(esp_timer_start_once(board->timer, left_us));
  ulTaskNotifyTake(pdTRUE, pdMS_TO_TICKS(BOARD_PATIENCE_MS));
  if (soon) (void)esp_timer_stop(board->timer);  // it may have fired: then there is nothing to stop
}

void board_hold(void) {
  ESP_ERROR_CHECK(gpio_hold_en(CS));
  ESP_ERROR_CHECK(gpio_hold_en(RST));
  gpio_deep_sleep_hold_en();
}
