// What nature does to a signal on its way. The firmware knows of it by its own tables; these are the air's.
#pragma once

namespace air {

// Power in dBm that comes in over a distance in m, in free space, from a sender at the legal limit.
double received_power_dbm(int channel, double distance_m);

// By how much later than it came a radio takes a signal of this power, as a length in m (APS011).
double power_bias_m(int channel, int prf_mhz, double rx_power_dbm);

}  // namespace air
