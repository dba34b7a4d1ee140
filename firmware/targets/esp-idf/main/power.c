#include "power.h"

#include "esp_err.h"
#include "esp_sleep.h"
#include "sdkconfig.h"

#define LEAST_SLEEP_US 10000  // shorter ones are refused

bool power_woke(void) { return esp_sleep_get_wakeup_cause() != ESP_SLEEP_WAKEUP_UNDEFINED; }

_Noreturn void power_sleep(uint64_t us) {
  // What is too long for the timer (59 years) is for good too.
  if (us != UINT64_MAX) (void)esp_sleep_enable_timer_wakeup(us < LEAST_SLEEP_US ? LEAST_SLEEP_US : us);
#if CONFIG_SYNCHRONIZAR_BUTTON_GPIO >= 0
  // EXT1, not EXT0: it works with the RTC's peripherals off.
  const uint64_t button = UINT64_C(1) << CONFIG_SYNCHRONIZAR_BUTTON_GPIO;
  ESP_ERROR_CHECK(esp_sleep_enable_ext1_wakeup_io(button, ESP_EXT1_WAKEUP_ALL_LOW));
#endif
  ESP_ERROR_CHECK(esp_sleep_pd_config(ESP_PD_DOMAIN_RTC_PERIPH, ESP_PD_OPTION_OFF));
  esp_deep_sleep_start();
}
