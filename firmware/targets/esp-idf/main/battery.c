#include "battery.h"

#include "sdkconfig.h"

#ifdef CONFIG_SYNCHRONIZAR_BATTERY

#include "esp_adc/adc_cali.h"
#include "esp_adc/adc_cali_scheme.h"
#include "esp_adc/adc_oneshot.h"
#include "esp_log.h"

#define TYPICAL_REFERENCE_MV 1100  // for chips without a calibration in their eFuses

static bool read_pin_mv(int* mv) {
  adc_unit_t unit = ADC_UNIT_1;
  adc_channel_t channel = ADC_CHANNEL_0;
  if (adc_oneshot_io_to_channel(CONFIG_SYNCHRONIZAR_BATTERY_GPIO, &unit, &channel) != ESP_OK) return false;

  adc_oneshot_unit_handle_t adc = NULL;
  const adc_oneshot_unit_init_cfg_t unit_settings = {.unit_id = unit};
  if (adc_oneshot_new_unit(&unit_settings, &adc) != ESP_OK) return false;

  const adc_oneshot_chan_cfg_t channel_settings = {.atten = ADC_ATTEN_DB_12,
                                                   .bitwidth = ADC_BITWIDTH_DEFAULT};
  const adc_cali_line_fitting_config_t line = {.unit_id = unit,
                                               .atten = ADC_ATTEN_DB_12,
                                               .bitwidth = ADC_BITWIDTH_DEFAULT,
                                               .default_vref = TYPICAL_REFERENCE_MV};
  adc_cali_handle_t calibration = NULL;
  int raw = 0;
  bool known = adc_oneshot_config_channel(adc, channel, &channel_settings) == ESP_OK &&
               adc_oneshot_read(adc, channel, &raw) == ESP_OK &&
               adc_cali_create_scheme_line_fitting(&line, &calibration) == ESP_OK;
  if (known) {
    known = adc_cali_raw_to_voltage(calibration, raw, mv) == ESP_OK;
    ESP_ERROR_CHECK(adc_cali_delete_scheme_line_fitting(calibration));
  }
  ESP_ERROR_CHECK(adc_oneshot_del_unit(adc));
  return known;
}

bool battery_suffices(void) {
  int pin_mv = 0;
  if (!read_pin_mv(&pin_mv)) {
    ESP_LOGW("battery", "cannot be read");
    return true;
  }
  const int mv = pin_mv * CONFIG_SYNCHRONIZAR_BATTERY_DIVIDER_PERCENT / 100;
  ESP_LOGI("battery", "%d mV", mv);
  return mv >= CONFIG_SYNCHRONIZAR_BATTERY_LEAST_MV;
}

#else

bool battery_suffices(void) { return true; }

#endif
