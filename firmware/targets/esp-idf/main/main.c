// A module's start, and the task that ranges.
#include <inttypes.h>
#include <string.h>

#include "battery.h"
#include "esp_err.h"
#include "esp_log.h"
#include "esp_mac.h"
#include "esp_task_wdt.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "hal_esp.h"
#include "network.h"
#include "node.h"
#include "power.h"
#include "provisioning.h"
#include "sdkconfig.h"
#include "store.h"

#define RANGING_CORE 1
#define RANGING_PRIORITY (configMAX_PRIORITIES - 2)
#define RANGING_STACK_BYTES 8192
#define NETWORK_PATIENCE_MS 10000  // ranges that cannot be told yet are of no use

static const char tag[] = "synchronizar";

struct module {
  struct network network;
  struct board board;
  struct node node;
  struct node_settings settings;
};

// The factory's MAC address of 48 bits, as IEEE makes 64 of it.
static uint64_t eui64_of_chip(void) {
  uint8_t mac[6];
  ESP_ERROR_CHECK(esp_efuse_mac_get_default(mac));
  const uint8_t bytes[8] = {mac[0], mac[1], mac[2], 0xFF, 0xFE, mac[3], mac[4], mac[5]};
  uint64_t eui64 = 0;
  for (size_t i = 0; i < sizeof bytes; ++i) eui64 = eui64 << 8 | bytes[i];
  return eui64;
}

static struct node_settings settings_of(const struct store_provision* provision, uint32_t restarts) {
  struct node_settings settings = {.session = provision->session,
                                   .address = provision->address,
                                   .eui64 = eui64_of_chip(),
                                   .restarts = restarts,
                                   .scheme = CONFIG_SYNCHRONIZAR_SCHEME,
                                   .channel = CONFIG_SYNCHRONIZAR_CHANNEL,
                                   .prf_mhz = CONFIG_SYNCHRONIZAR_PRF_MHZ,
                                   .range_s = CONFIG_SYNCHRONIZAR_RANGE_S,
                                   .sleep_s = CONFIG_SYNCHRONIZAR_SLEEP_S,
                                   .calibration = store_read_calibration()};
  memcpy(settings.key, provision->key, sizeof settings.key);
  return settings;
}

static _Noreturn void sleep_until(struct module* module, uint64_t deadline_us) {
  network_stop(&module->network);
  const uint32_t dropped = module->node.outbox.dropped + network_take_lost(&module->network);
  ESP_LOGI(tag, "sleeps; %" PRIu32 " ranges were too old to be told", dropped);
  board_hold();
  const uint64_t now = module->board.hal.now_us(module->board.hal.board);
  const uint64_t left_us = deadline_us > now ? deadline_us - now : 0;
  power_sleep(deadline_us == UINT64_MAX ? UINT64_MAX : left_us);
}

static void say_calibration(const struct calibration* calibration) {
  ESP_LOGI(tag, "antenna delay %" PRIu32 " at %d hundredths of a degree Celsius, sigma %u mm",
           calibration->antenna_delay, calibration->temperature_cc, (unsigned)calibration->sigma_mm);
}

// The radio must not stay awake while the board spares its battery.
static _Noreturn void spare_battery(struct module* module) {
  board_start(&module->board, NULL);
  const struct dw1000_settings settings = {.channel = CONFIG_SYNCHRONIZAR_CHANNEL,
                                           .prf_mhz = CONFIG_SYNCHRONIZAR_PRF_MHZ};
  struct dw1000 radio;
  if (!power_woke() && dw1000_start(&radio, &module->board.hal, &settings) == DW1000_OK) dw1000_sleep(&radio);
  board_hold();
  power_sleep(CONFIG_SYNCHRONIZAR_SLEEP_S == 0 ? UINT64_MAX
                                               : CONFIG_SYNCHRONIZAR_SLEEP_S * UINT64_C(1000000));
}

// Right after the start nothing waits to be sent yet.
static void say_radio(struct node* node) {
  if (node->state == NODE_RANGING) {
    ESP_LOGI(tag, "radio has %d hundredths of a degree Celsius", dw1000_temperature_cc(&node->radio));
  } else {
    ESP_LOGE(tag, "radio does not answer");
  }
}

static void range(void* context) {
  struct module* module = context;
  ESP_ERROR_CHECK(esp_task_wdt_add(NULL));
  board_start(&module->board, &module->network);
  network_listen(&module->network, xTaskGetCurrentTaskHandle());
  uint64_t deadline_us = node_start(&module->node, &module->board.hal, &module->settings, power_woke());
  say_radio(&module->node);
  while (module->node.state != NODE_ASLEEP) {
    board_wait(&module->board, deadline_us);
    struct network_order order;
    while (network_hear(&module->network, &order)) (void)node_hear(&module->node, order.bytes, order.size);
    module->node.outbox.dropped += network_take_lost(&module->network);
    deadline_us = node_run(&module->node);
    if (module->node.state == NODE_SILENT) vTaskDelay(1);  // the line of a radio that is not there may float
    ESP_ERROR_CHECK(esp_task_wdt_reset());
  }
  sleep_until(module, deadline_us);
}

void app_main(void);

void app_main(void) {
  static struct module module;
  if (!store_open()) {
    ESP_LOGE(tag, "flash cannot be read: erase it, and provision with a new session and key");
    return;
  }
  provisioning_start();
  struct store_provision provision;
  if (!store_read_provision(&provision)) {
    ESP_LOGW(tag, "waits for `provision` on this console");
    return;
  }
  if (!battery_suffices()) {
    ESP_LOGW(tag, "battery too low to range");
    spare_battery(&module);
  }
  uint32_t restarts = 0;
  if (!store_count_restart(&restarts)) {
    ESP_LOGE(tag, "restarts cannot be counted; nothing is sent");
    return;
  }
  module.settings = settings_of(&provision, restarts);
  ESP_LOGI(tag, "session %" PRIu32 ", address %u, start %" PRIu32, provision.session,
           (unsigned)provision.address, restarts);
  say_calibration(&module.settings.calibration);
  network_start(&module.network, &provision);
  network_await(&module.network, NETWORK_PATIENCE_MS);
  const BaseType_t made = xTaskCreatePinnedToCore(range, "ranging", RANGING_STACK_BYTES, &module,
                                                  RANGING_PRIORITY, NULL, RANGING_CORE);
  ESP_ERROR_CHECK(made == pdPASS ? ESP_OK : ESP_ERR_NO_MEM);
}
