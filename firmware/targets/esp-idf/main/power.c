#include "power.h"

#include "esp_err.h"
#include "esp_sleep.h"
#include "sdkconfig.h"

#define LEAST_SLEEP_US 10000  // shorter ones are refused

#if CONFIG_SYNCHRONIZAR_BUTTON_GPIO >= 0
#define BUTTON (UINT64_C(1) << CONFIG_SYNCHRONIZAR_BUTTON_GPIO)
// The ESP32's pins with an RTC function: 0, 2, 4, 12 to 15, 25 to 27, 32 to 39.
#define WAKING_PINS UINT64_C(0xFF0E00F015)
_Static_assert((BUTTON & WAKING_PINS) != 0, "the button's GPIO cannot wake the ESP32 from deep sleep");
#endif

bool power_woke(void) { return esp_sleep_get_wakeup_cause() != ESP_SLEEP_WAKEUP_UNDEFINED; }

_Noreturn void power_sleep(uint64_t us) {
  // What is too long for the timer (59 years) is for good too.
  if (us != UINT64_MAX) (void)esp_sleep_enable_timer_wakeup(us < LEAST_SLEEP_US ? LEAST_SLEEP_US : us);
#if CONFIG_SYNCHRONIZAR_BUTTON_GPIO >= 0
  // EXT1, not EXT0: it works with the RTC's peripherals off.
  ESP_ERROR_CHECK(esp_sleep_enable_ext1_wakeup_io(BUTTON, ESP_EXT1_WAKEUP_ALL_LOW));
#endif
  ESP_ERROR_CHECK(esp_sleep_pd_config(ESP_PD_DOMAIN_RTC_PERIPH, ESP_PD_OPTION_OFF));
  esp_deep_sleep_start();
}
