#include "firmware/sim/propagation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <stdexcept>

#include "firmware/sim/time.h"

namespace air {

namespace {

constexpr double kPi = 3.14159265358979323846;

// -41.3 dBm/MHz over 500 MHz, the limit of FCC 15.519 and EN 302 065. About -63 dBm are left after 1 m on
// channel 5.
constexpr double kLimitDbmPerMhz = -41.3;
constexpr double kBandwidthMhz = 500.0;
constexpr double kShortestM = 0.1;  // nearer than that Friis does not hold

// APS011, PRF 64 MHz, channels 500 MHz wide: from -61 dBm down in steps of 2 dB.
constexpr double kStrongestDbm = -61.0;
constexpr double kStepDb = 2.0;
constexpr std::array<double, 17> kBiasM = {-0.110, -0.105, -0.100, -0.093, -0.082, -0.069,
                                           -0.051, -0.027, 0.0,    0.021,  0.035,  0.042,
                                           0.049,  0.062,  0.071,  0.076,  0.081};

// Centre frequencies (UM table 61).
double centre_hz(int channel) {
  switch (channel) {
    case 1:
      return 3494.4e6;
    case 2:
    case 4:
      return 3993.6e6;
    case 3:
      return 4492.8e6;
    case 5:
    case 7:
      return 6489.6e6;
    default:
      throw std::invalid_argument("no such channel");
  }
}

}  // namespace

double received_power_dbm(int channel, double distance_m) {
  const double sent_dbm = kLimitDbmPerMhz + 10.0 * std::log10(kBandwidthMhz);
  const double wavelength_m = kSpeedOfLight / centre_hz(channel);
  return sent_dbm + 20.0 * std::log10(wavelength_m / (4.0 * kPi * std::max(distance_m, kShortestM)));
}

double power_bias_m(int channel, int prf_mhz, double rx_power_dbm) {
  // For other settings there is no table here, and no bias.
  if (prf_mhz != 64 || channel == 4 || channel == 7) return 0.0;
  const double step =
      std::clamp((kStrongestDbm - rx_power_dbm) / kStepDb, 0.0, static_cast<double>(kBiasM.size() - 1));
  const auto i = std::min(static_cast<std::size_t>(step), kBiasM.size() - 2);
  return kBiasM[i] + (step - static_cast<double>(i)) * (kBiasM[i + 1] - kBiasM[i]);
}

}  // namespace air
