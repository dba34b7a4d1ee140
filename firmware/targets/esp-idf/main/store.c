#include "store.h"

#include "nvs.h"
#include "nvs_flash.h"

static const char name_space[] = "synchronizar";

bool store_open(void) { return nvs_flash_init() == ESP_OK; }

// One blob a record: written as a whole or not at all.
static bool read_blob(const char* name, void* blob, size_t size) {
  nvs_handle_t nvs;
  if (nvs_open(name_space, NVS_READONLY, &nvs) != ESP_OK) return false;
  size_t found = size;
  const esp_err_t error = nvs_get_blob(nvs, name, blob, &found);
  nvs_close(nvs);
  return error == ESP_OK && found == size;
}

static bool write_blob(const char* name, const void* blob, size_t size) {
  nvs_handle_t nvs;
  if (nvs_open(name_space, NVS_READWRITE, &nvs) != ESP_OK) return false;
  const bool kept = nvs_set_blob(nvs, name, blob, size) == ESP_OK && nvs_commit(nvs) == ESP_OK;
  nvs_close(nvs);
  return kept;
}

bool store_read_provision(struct store_provision* provision) {
  return read_blob("provision", provision, sizeof *provision);
}

bool store_write_provision(const struct store_provision* provision) {
  return write_blob("provision", provision, sizeof *provision);
}

struct calibration store_read_calibration(void) {
  struct calibration calibration;
  if (read_blob("calibration", &calibration, sizeof calibration)) return calibration;
  // Typical for a DWM1000: 16436 ticks each way (257 ns) at PRF 64 MHz.
  return (struct calibration){.antenna_delay = 2 * 16436, .temperature_cc = 2300};
}

bool store_write_calibration(const struct calibration* calibration) {
  return write_blob("calibration", calibration, sizeof *calibration);
}

bool store_count_restart(uint32_t* restarts) {
  nvs_handle_t nvs;
  if (nvs_open(name_space, NVS_READWRITE, &nvs) != ESP_OK) return false;
  uint32_t before = 0;
  const esp_err_t error = nvs_get_u32(nvs, "restarts", &before);
  *restarts = before + 1;
  const bool kept = (error == ESP_OK || error == ESP_ERR_NVS_NOT_FOUND) && before < UINT32_MAX &&
                    nvs_set_u32(nvs, "restarts", *restarts) == ESP_OK && nvs_commit(nvs) == ESP_OK;
  nvs_close(nvs);
  return kept;
}
