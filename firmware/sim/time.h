// Simulated time, in femtoseconds. 64 bits would end after two and a half hours.
#pragma once

#include <cstdint>

namespace air {

__extension__ using Femto = __int128;

constexpr Femto kMicrosecond = 1'000'000'000;
constexpr Femto kMillisecond = 1000 * kMicrosecond;
constexpr Femto kSecond = 1000 * kMillisecond;
constexpr double kSpeedOfLight = 299'792'458.0;  // m/s

constexpr Femto seconds(double s) { return static_cast<Femto>(s * 1e15); }
constexpr double to_seconds(Femto t) { return static_cast<double>(t) * 1e-15; }

}  // namespace air
