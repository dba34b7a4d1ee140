// Stub for checking the target's sources without ESP-IDF: declarations alone, of what they use.
#pragma once

void esp_log_stub(const char* tag, const char* format, ...) __attribute__((format(printf, 2, 3)));

#define ESP_LOGE(...) esp_log_stub(__VA_ARGS__)
#define ESP_LOGW(...) esp_log_stub(__VA_ARGS__)
#define ESP_LOGI(...) esp_log_stub(__VA_ARGS__)
