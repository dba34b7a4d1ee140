// Stub for checking the target's sources without ESP-IDF: declarations alone, of what they use.
#pragma once

#include <stdint.h>

typedef int BaseType_t;
typedef unsigned int UBaseType_t;
typedef uint32_t TickType_t;

#define pdFALSE ((BaseType_t)0)
#define pdTRUE ((BaseType_t)1)
#define pdPASS pdTRUE
#define portMAX_DELAY ((TickType_t)0xFFFFFFFFU)
#define configMAX_PRIORITIES 25
#define pdMS_TO_TICKS(ms) ((TickType_t)(ms))  // 1000 Hz, as in sdkconfig.defaults

void vPortYieldFromISR(void);
#define portYIELD_FROM_ISR(woken)                \
  do {                                           \
    if ((woken) != pdFALSE) vPortYieldFromISR(); \
  } while (0)
