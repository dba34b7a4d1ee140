#include "factors/walk_steps.h"

#include <cmath>

#include "factors/gauss_newton.h"

namespace synchronizar {

SlamStep step_to(int keyframe, const WalkLayout& layout, const WalkStates& states, const Vector3& sigma) {
  const int here = keyframe - 1;
  const auto p = states.places.row(here), q = states.places.row(keyframe);
  const double s = std::exp(states.calibration(layout.user(keyframe), 0));
  const double c = std::cos(p[3]) / s, n = std::sin(p[3]) / s, dx = q[0] - p[0], dy = q[1] - p[1];
  const double x = c * dx + n * dy, y = -n * dx + c * dy, z = (q[2] - p[2]) / s;
  const Vector3 slam = layout.walks().slam.row(keyframe) - layout.walks().slam.row(here);
  SlamStep out;
  out.here = here;
  out.there = keyframe;
  out.residual << x - slam[0], y - slam[1], z - slam[2], wrapped(q[3] - p[3]);
  out.by_there << c, n, 0.0, 0.0,  //
      -n, c, 0.0, 0.0,             //
      0.0, 0.0, 1.0 / s, 0.0,      //
      0.0, 0.0, 0.0, 1.0;
  out.by_here = -out.by_there;
  out.by_here(0, 3) = y;
  out.by_here(1, 3) = -x;
  out.by_scale << -x, -y, -z, 0.0;
  out.by_scale += layout.height_by_scale(here, states) * out.by_here.col(2);
  const Eigen::Vector4d root(1.0 / sigma[0], 1.0 / sigma[0], 1.0 / sigma[1], 1.0 / sigma[2]);
  out.residual = root.cwiseProduct(out.residual);
  out.by_here = root.asDiagonal() * out.by_here;
  out.by_there = root.asDiagonal() * out.by_there;
  out.by_scale = root.cwiseProduct(out.by_scale);
  return out;
}

void add_step(WalkSystem& system, const WalkLayout& layout, const SlamStep& step) {
  const Where& here = layout.keyframe(step.here);
  const Where& there = layout.keyframe(step.there);
  system.add(here, here, (step.by_here.transpose() * step.by_here).eval());
  system.add(there, there, (step.by_there.transpose() * step.by_there).eval());
  system.add(there, here, (step.by_there.transpose() * step.by_here).eval());
  system.add_gradient(here, (step.by_here.transpose() * step.residual).eval());
  system.add_gradient(there, (step.by_there.transpose() * step.residual).eval());
  const Where& scale = layout.device(layout.user(step.there));
  const Eigen::RowVector4d by_scale = step.by_scale.transpose();
  system.add(scale, here, (by_scale * step.by_here).eval());
  system.add(scale, there, (by_scale * step.by_there).eval());
  system.add(scale, scale, (by_scale * step.by_scale).eval());
  system.add_gradient(scale, (by_scale * step.residual).eval());
}

}  // namespace synchronizar
