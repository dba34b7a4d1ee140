// Each of these binds one part of the core into the module.
#pragma once

#include <nanobind/nanobind.h>

namespace synchronizar {

void bind_losses(nanobind::module_& m);
void bind_ranges(nanobind::module_& m);
void bind_nlos_bursts(nanobind::module_& m);
void bind_walk_solver(nanobind::module_& m);
void bind_rigid_solver(nanobind::module_& m);
void bind_searches(nanobind::module_& m);
void bind_adjustment(nanobind::module_& m);
void bind_neighbours(nanobind::module_& m);
void bind_followed_ranges(nanobind::module_& m);
void bind_innovations(nanobind::module_& m);
void bind_poses(nanobind::module_& m);

}  // namespace synchronizar
