// Wi-Fi and UDP, on core 0. The ranging task only ever touches queues: a call into TCP/IP may wait longer
// than a slot.
#pragma once

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "freertos/FreeRTOS.h"
#include "freertos/queue.h"
#include "freertos/task.h"
#include "store.h"

#define NETWORK_ORDER_SIZE 128  // at most; an order is far smaller

struct network_order {
  size_t size;
  uint8_t bytes[NETWORK_ORDER_SIZE];
};

struct network {
  atomic_bool connected;
  atomic_uint lost;  // ranges that got too old here, since they were last taken
  int socket;
  QueueHandle_t datagrams;  // to the collector
  QueueHandle_t orders;     // from it
  TaskHandle_t listener;    // whom an order wakes
};

// Joins the network, and again whenever it is lost.
void network_start(struct network* network, const struct store_provision* provision);

// Until connected, or for so long.
void network_await(const struct network* network, uint32_t ms);

// From now on `listener` is notified of orders.
void network_listen(struct network* network, TaskHandle_t listener);

// Whatever the collector said next; false: nothing more.
bool network_hear(struct network* network, struct network_order* order);

// Never waits. False: no network, or no room. What it takes it tries to tell until it is OUTBOX_TOO_OLD_US
// old.
bool network_send(const struct network* network, const uint8_t* datagram, size_t size);

// How many of the ranges that were taken could not be told, since the last call.
uint32_t network_take_lost(struct network* network);

// Tells what is still queued, then leaves.
void network_stop(const struct network* network);
