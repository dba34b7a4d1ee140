// Python bindings of the core: arrays in, arrays out. Shapes and signs are checked here; faults raise
// ValueError.
#include "bindings/bindings.h"

NB_MODULE(_core, m) {
  using namespace synchronizar;
  bind_losses(m);
  bind_ranges(m);
  bind_nlos_bursts(m);
  bind_walk_solver(m);
  bind_rigid_solver(m);
  bind_searches(m);
  bind_adjustment(m);
  bind_neighbours(m);
  bind_followed_ranges(m);
  bind_innovations(m);
  bind_poses(m);
}
