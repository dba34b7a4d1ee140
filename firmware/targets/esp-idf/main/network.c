#include "network.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <string.h>
#include <sys/socket.h>

#include "esp_err.h"
#include "esp_event.h"
#include "esp_netif.h"
#include "esp_timer.h"
#include "esp_wifi.h"
#include "outbox.h"
#include "sdkconfig.h"

#define WIFI_CORE 0
#define PRIORITY 5
#define STACK_BYTES 4096
#define DATAGRAMS 4  // that may wait: as many as hold all the ranges that the core keeps
#define ORDERS 4
#define FLUSH_MS 50

_Static_assert(OUTBOX_ROOM <= DATAGRAMS * (WIRE_MAX_RANGES), "the last ranges before the sleep have room");

struct datagram {
  int64_t queued_us;  // when, of the board's clock
  size_t size;
  uint8_t bytes[WIRE_MAX_SIZE];
};

static void on_event(void* context, esp_event_base_t base, int32_t id, void* data) {
  struct network* network = context;
  (void)data;
  if (base == IP_EVENT && id == IP_EVENT_STA_GOT_IP) {
    atomic_store(&network->connected, true);
  } else if (base == WIFI_EVENT && id == WIFI_EVENT_STA_START) {
    (void)esp_wifi_connect();  // where it fails, a disconnection follows
  } else if (base == WIFI_EVENT && id == WIFI_EVENT_STA_DISCONNECTED) {
    atomic_store(&network->connected, false);
    (void)esp_wifi_connect();
  }
}

// A datagram without ranges is a header and a tag.
static unsigned ranges_in(const struct datagram* datagram) {
  return (unsigned)((datagram->size - WIRE_HEADER_SIZE - WIRE_TAG_SIZE) / WIRE_RANGE_SIZE);
}

// Whatever hinders it, no room in TCP/IP or no network: it is tried until it is too old.
static void tell_datagram(struct network* network, const struct datagram* datagram) {
  while (esp_timer_get_time() - datagram->queued_us <= OUTBOX_TOO_OLD_US) {
    if (atomic_load(&network->connected) &&
        send(network->socket, datagram->bytes, datagram->size, MSG_DONTWAIT) >= 0)
      return;
    vTaskDelay(1);
  }
  atomic_fetch_add(&network->lost, ranges_in(datagram));
}

// Tells the collector what is queued. Where that cannot be told the queue fills, and the core keeps its
// ranges.
static void tell(void* context) {
  struct network* network = context;
  struct datagram datagram;
  for (;;) {
    if (xQueueReceive(network->datagrams, &datagram, portMAX_DELAY) == pdTRUE)
      tell_datagram(network, &datagram);
  }
}

static void hear(void* context) {
  struct network* network = context;
  struct network_order order;
  for (;;) {
    const ssize_t size = recv(network->socket, order.bytes, sizeof order.bytes, 0);
    if (size <= 0) {
      vTaskDelay(pdMS_TO_TICKS(100));
      continue;
    }
    order.size = (size_t)size;
    if (xQueueSend(network->orders, &order, 0) == pdTRUE) (void)xTaskNotifyGive(network->listener);
  }
}

static void start_task(TaskFunction_t function, const char* name, struct network* network) {
  const BaseType_t made =
      xTaskCreatePinnedToCore(function, name, STACK_BYTES, network, PRIORITY, NULL, WIFI_CORE);
  ESP_ERROR_CHECK(made == pdPASS ? ESP_OK : ESP_ERR_NO_MEM);
}

static void start_socket(struct network* network, const char* collector) {
  struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(CONFIG_SYNCHRONIZAR_COLLECTOR_PORT)};
  network->socket = socket(AF_INET, SOCK_DGRAM, IPPROTO_UDP);
  // Connected: only the collector is heard.
  const bool ready = network->socket >= 0 && inet_pton(AF_INET, collector, &address.sin_addr) == 1 &&
                     connect(network->socket, (const struct sockaddr*)&address, sizeof address) == 0;
  ESP_ERROR_CHECK(ready ? ESP_OK : ESP_FAIL);
}

static void start_wifi(struct network* network, const struct store_provision* provision) {
  const wifi_init_config_t init = WIFI_INIT_CONFIG_DEFAULT();
  ESP_ERROR_CHECK(esp_wifi_init(&init));
  ESP_ERROR_CHECK(esp_event_handler_instance_register(WIFI_EVENT, ESP_EVENT_ANY_ID, on_event, network, NULL));
  ESP_ERROR_CHECK(
      esp_event_handler_instance_register(IP_EVENT, IP_EVENT_STA_GOT_IP, on_event, network, NULL));
  ESP_ERROR_CHECK(esp_wifi_set_storage(WIFI_STORAGE_RAM));  // credentials stand in one place, ours
  ESP_ERROR_CHECK(esp_wifi_set_mode(WIFI_MODE_STA));
  wifi_config_t config = {
      .sta = {.threshold.authmode = provision->password[0] == '\0' ? WIFI_AUTH_OPEN : WIFI_AUTH_WPA2_PSK}};
  // Fields of 32 and 64 bytes that need no zero at the end.
  memcpy(config.sta.ssid, provision->ssid, strlen(provision->ssid));
  memcpy(config.sta.password, provision->password, strlen(provision->password));
  ESP_ERROR_CHECK(esp_wifi_set_config(WIFI_IF_STA, &config));
  ESP_ERROR_CHECK(esp_wifi_start());
  ESP_ERROR_CHECK(
      esp_wifi_set_ps(WIFI_PS_NONE));  // modem sleep would hold datagrams back for 100 ms and more
}

void network_start(struct network* network, const struct store_provision* provision) {
  atomic_init(&network->connected, false);
  atomic_init(&network->lost, 0);
  network->listener = NULL;
  network->datagrams = xQueueCreate(DATAGRAMS, sizeof(struct datagram));
  network->orders = xQueueCreate(ORDERS, sizeof(struct network_order));
  ESP_ERROR_CHECK(network->datagrams != NULL && network->orders != NULL ? ESP_OK : ESP_ERR_NO_MEM);
  ESP_ERROR_CHECK(esp_netif_init());
  ESP_ERROR_CHECK(esp_event_loop_create_default());
  ESP_ERROR_CHECK(esp_netif_create_default_wifi_sta() != NULL ? ESP_OK : ESP_ERR_NO_MEM);
  start_socket(network, provision->collector);
  start_wifi(network, provision);
  start_task(tell, "tell", network);
}

void network_await(const struct network* network, uint32_t ms) {
  for (uint32_t waited = 0; waited < ms && !atomic_load(&network->connected); waited += 10) {
    vTaskDelay(pdMS_TO_TICKS(10));
  }
}

void network_listen(struct network* network, TaskHandle_t listener) {
  network->listener = listener;
  start_task(hear, "hear", network);
}

bool network_hear(struct network* network, struct network_order* order) {
  return xQueueReceive(network->orders, order, 0) == pdTRUE;
}

bool network_send(const struct network* network, const uint8_t* bytes, size_t size) {
  if (size > WIRE_MAX_SIZE || !atomic_load(&network->connected)) return false;
  struct datagram datagram = {.queued_us = esp_timer_get_time(), .size = size};
  memcpy(datagram.bytes, bytes, size);
  return xQueueSend(network->datagrams, &datagram, 0) == pdTRUE;
}

uint32_t network_take_lost(struct network* network) { return atomic_exchange(&network->lost, 0); }

void network_stop(const struct network* network) {
  for (int waited = 0; waited < FLUSH_MS && uxQueueMessagesWaiting(network->datagrams) > 0; ++waited) {
    vTaskDelay(pdMS_TO_TICKS(1));
  }
  vTaskDelay(pdMS_TO_TICKS(FLUSH_MS));  // what has left the queue is not on the air yet
  ESP_ERROR_CHECK(esp_wifi_stop());
}
