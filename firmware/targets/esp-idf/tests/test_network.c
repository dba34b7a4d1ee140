// What becomes of datagrams upon a pretended ESP-IDF: told, tried again, or given up and counted.
#include <errno.h>
#include <netinet/in.h>
#include <setjmp.h>
#include <string.h>
#include <sys/socket.h>

#include "esp_event.h"
#include "esp_netif.h"
#include "esp_timer.h"
#include "esp_wifi.h"
#include "firmware/tests/check.h"
#include "network.h"

#define ROOM 4
#define SOCKET 54
#define GREETING_SIZE 56  // bytes of a datagram without ranges, and
#define RANGE_SIZE 24     // of each range (PROTOCOL.md)
#define FOREVER INT64_MAX

struct QueueDefinition {
  unsigned item_size, count;
  uint8_t item[ROOM][1024];
};

static struct {
  struct QueueDefinition queue[2];
  int queues;
  TaskFunction_t tell;
  void* tell_context;
  jmp_buf idle;  // where a task goes that has nothing to do
  esp_event_handler_t handler;
  void* handler_context;
  int64_t now_us;  // moves only by delays
  int64_t refuses_until_us, comes_back_us;
  int refuses_with, sent, tried;
  size_t sent_size;
} esp;

static struct network network;

esp_event_base_t const WIFI_EVENT = "wifi", IP_EVENT = "ip";

static void becomes_connected(void) { esp.handler(esp.handler_context, IP_EVENT, IP_EVENT_STA_GOT_IP, NULL); }

static void loses_its_network(void) {
  esp.handler(esp.handler_context, WIFI_EVENT, WIFI_EVENT_STA_DISCONNECTED, NULL);
}

int64_t esp_timer_get_time(void) { return esp.now_us; }

void vTaskDelay(TickType_t ticks) {
  esp.now_us += ticks * INT64_C(1000);
  if (esp.now_us < esp.comes_back_us) return;
  esp.comes_back_us = FOREVER;
  becomes_connected();
}

QueueHandle_t xQueueCreate(UBaseType_t length, UBaseType_t item_size) {
  CHECK_EQUAL(length, ROOM);
  CHECK_WITHIN(item_size, 1, sizeof esp.queue[0].item[0]);
  struct QueueDefinition* queue = &esp.queue[esp.queues++];
  queue->item_size = item_size;
  return queue;
}

BaseType_t xQueueSend(struct QueueDefinition* queue, const void* item, TickType_t ticks) {
  CHECK_EQUAL(ticks, 0);
  if (queue->count == ROOM) return pdFALSE;
  memcpy(queue->item[queue->count++], item, queue->item_size);
  return pdTRUE;
}

BaseType_t xQueueReceive(struct QueueDefinition* queue, void* item, TickType_t ticks) {
  if (queue->count == 0 && ticks == portMAX_DELAY) longjmp(esp.idle, 1);
  if (queue->count == 0) return pdFALSE;
  memcpy(item, queue->item[0], queue->item_size);
  memmove(queue->item[0], queue->item[1], sizeof queue->item - sizeof queue->item[0]);
  --queue->count;
  return pdTRUE;
}

UBaseType_t uxQueueMessagesWaiting(QueueHandle_t queue) { return queue->count; }

BaseType_t xTaskCreatePinnedToCore(TaskFunction_t task, const char* name, uint32_t stack_bytes,
                                   void* parameters, UBaseType_t priority, TaskHandle_t* created,
                                   BaseType_t core) {
  (void)stack_bytes, (void)priority, (void)created;
  CHECK(strcmp(name, "tell") == 0);
  CHECK_EQUAL(core, 0);
  esp.tell = task;
  esp.tell_context = parameters;
  return pdPASS;
}

BaseType_t xTaskNotifyGive(TaskHandle_t task) {
  (void)task;
  return pdPASS;
}

esp_err_t esp_event_loop_create_default(void) { return ESP_OK; }

esp_err_t esp_event_handler_instance_register(esp_event_base_t base, int32_t id, esp_event_handler_t handler,
                                              void* context, esp_event_handler_instance_t* instance) {
  (void)base, (void)id, (void)instance;
  esp.handler = handler;
  esp.handler_context = context;
  return ESP_OK;
}

esp_err_t esp_netif_init(void) { return ESP_OK; }
esp_netif_t* esp_netif_create_default_wifi_sta(void) { return (esp_netif_t*)&esp; }
esp_err_t esp_wifi_init(const wifi_init_config_t* config) { return config != NULL ? ESP_OK : ESP_FAIL; }
esp_err_t esp_wifi_set_storage(wifi_storage_t storage) {
  return storage == WIFI_STORAGE_RAM ? ESP_OK : ESP_FAIL;
}
esp_err_t esp_wifi_set_mode(wifi_mode_t mode) { return mode == WIFI_MODE_STA ? ESP_OK : ESP_FAIL; }
esp_err_t esp_wifi_set_config(wifi_interface_t interface, wifi_config_t* config) {
  (void)config;
  return interface == WIFI_IF_STA ? ESP_OK : ESP_FAIL;
}
esp_err_t esp_wifi_set_ps(wifi_ps_type_t type) { return type == WIFI_PS_NONE ? ESP_OK : ESP_FAIL; }
esp_err_t esp_wifi_start(void) { return ESP_OK; }
esp_err_t esp_wifi_stop(void) { return ESP_OK; }
esp_err_t esp_wifi_connect(void) { return ESP_OK; }

int socket(int domain, int type, int protocol) {
  return domain == AF_INET && type == SOCK_DGRAM && protocol == IPPROTO_UDP ? SOCKET : -1;
}

int connect(int descriptor, const struct sockaddr* address, socklen_t size) {
  return descriptor == SOCKET && address != NULL && size == sizeof(struct sockaddr_in) ? 0 : -1;
}

ssize_t send(int descriptor, const void* data, size_t size, int flags) {
  CHECK_EQUAL(descriptor, SOCKET);
  CHECK_EQUAL(flags, MSG_DONTWAIT);
  ++esp.tried;
  if (esp.now_us < esp.refuses_until_us) {
    errno = esp.refuses_with;
    return -1;
  }
  CHECK_EQUAL(((const uint8_t*)data)[0], esp.sent);  // in the order in which they were queued
  ++esp.sent;
  esp.sent_size = size;
  return (ssize_t)size;
}

ssize_t recv(int descriptor, void* data, size_t size, int flags) {
  (void)descriptor, (void)data, (void)size, (void)flags;
  return -1;
}

static void start(void) {
  memset(&esp, 0, sizeof esp);
  esp.comes_back_us = FOREVER;
  esp.now_us = 5000000000;  // past 32 bits
  static const struct store_provision provision = {
      .ssid = "net", .password = "password", .collector = "10.0.0.1"};
  network_start(&network, &provision);
  becomes_connected();
}

static uint8_t next;  // numbers the datagrams of a test

static bool queue_ranges(unsigned ranges) {
  const uint8_t datagram[GREETING_SIZE + 32 * RANGE_SIZE] = {next};
  if (!network_send(&network, datagram, GREETING_SIZE + ranges * RANGE_SIZE)) return false;
  ++next;
  return true;
}

static void begin(void) {
  start();
  next = 0;
}

static void run_until_idle(void) {
  if (setjmp(esp.idle) == 0) esp.tell(esp.tell_context);
}

static void a_datagram_is_told_as_it_is_and_once(void) {
  begin();
  CHECK(queue_ranges(3));
  run_until_idle();
  CHECK_EQUAL(esp.sent, 1);
  CHECK_EQUAL(esp.tried, 1);
  CHECK_EQUAL(esp.sent_size, GREETING_SIZE + 3 * RANGE_SIZE);
  CHECK_EQUAL(network_take_lost(&network), 0);
}

static void without_a_network_or_room_nothing_is_taken(void) {
  begin();
  for (int i = 0; i < ROOM; ++i) CHECK(queue_ranges(32));
  CHECK(!queue_ranges(1));
  run_until_idle();
  CHECK_EQUAL(esp.sent, ROOM);
  loses_its_network();
  CHECK(!queue_ranges(1));
  CHECK_EQUAL(network_take_lost(&network), 0);
}

static void what_is_refused_for_a_while_is_told_later(void) {
  static const int errors[] = {ENOMEM, EAGAIN, EHOSTUNREACH, EIO};
  for (size_t i = 0; i < sizeof errors / sizeof errors[0]; ++i) {
    begin();
    esp.refuses_with = errors[i];
    esp.refuses_until_us = esp.now_us + 499000;
    CHECK(queue_ranges(32));
    CHECK(queue_ranges(1));
    run_until_idle();
    CHECK_EQUAL(esp.sent, 2);
    CHECK_EQUAL(network_take_lost(&network), 0);
  }
}

static void what_is_refused_for_500_ms_is_dropped_and_counted(void) {
  static const int errors[] = {ENOMEM, EAGAIN, EHOSTUNREACH, EIO};
  for (size_t i = 0; i < sizeof errors / sizeof errors[0]; ++i) {
    begin();
    const int64_t queued_us = esp.now_us;
    esp.refuses_with = errors[i];
    esp.refuses_until_us = FOREVER;
    CHECK(queue_ranges(32));
    CHECK(queue_ranges(0));
    CHECK(queue_ranges(1));
    run_until_idle();
    CHECK_EQUAL(esp.sent, 0);
    CHECK_WITHIN(esp.now_us - queued_us, 500000, 502000);  // those behind it are as old by then
    CHECK_EQUAL(network_take_lost(&network), 33);
  }
}

static void a_network_lost_after_queueing_may_come_back_in_time(void) {
  begin();
  CHECK(queue_ranges(32));
  loses_its_network();
  esp.comes_back_us = esp.now_us + 400000;
  run_until_idle();
  CHECK_EQUAL(esp.sent, 1);
  CHECK_EQUAL(esp.tried, 1);
  CHECK_EQUAL(network_take_lost(&network), 0);
}

static void a_network_lost_after_queueing_loses_nothing_uncounted(void) {
  begin();
  CHECK(queue_ranges(32));
  CHECK(queue_ranges(7));
  loses_its_network();
  run_until_idle();
  CHECK_EQUAL(esp.tried, 0);
  CHECK_EQUAL(network_take_lost(&network), 39);
}

static void what_has_waited_too_long_in_the_queue_is_not_told(void) {
  begin();
  CHECK(queue_ranges(5));
  esp.now_us += 500001;
  CHECK(queue_ranges(2));
  esp.sent = 1;  // the one that is expected next
  run_until_idle();
  CHECK_EQUAL(esp.sent, 2);
  CHECK_EQUAL(esp.tried, 1);
  CHECK_EQUAL(network_take_lost(&network), 5);
}

static void losses_add_up_until_they_are_taken(void) {
  begin();
  loses_its_network();
  for (int i = 1; i <= 2; ++i) {
    becomes_connected();
    CHECK(queue_ranges(4));
    loses_its_network();
    run_until_idle();
  }
  CHECK_EQUAL(network_take_lost(&network), 8);
  CHECK_EQUAL(network_take_lost(&network), 0);
}

int main(void) {
  a_datagram_is_told_as_it_is_and_once();
  without_a_network_or_room_nothing_is_taken();
  what_is_refused_for_a_while_is_told_later();
  what_is_refused_for_500_ms_is_dropped_and_counted();
  a_network_lost_after_queueing_may_come_back_in_time();
  a_network_lost_after_queueing_loses_nothing_uncounted();
  what_has_waited_too_long_in_the_queue_is_not_told();
  losses_add_up_until_they_are_taken();
  return check_verdict();
}
