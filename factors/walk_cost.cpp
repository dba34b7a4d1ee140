#include "factors/walk_cost.h"

#include <variant>

#include "factors/walk_priors.h"
#include "factors/walk_ranges.h"
#include "factors/walk_steps.h"

namespace synchronizar {

double walk_cost(const WalkLayout& layout, const WalkStates& states, const WalkNoise& noise,
                 const Loss& loss) {
  const Column& sigma = layout.walks().sigma;
  const Column e = range_residuals(layout, states, noise.assumed_clock).cwiseQuotient(sigma);
  double sum = 0.0;
  std::visit(
      [&](const auto& kind) {
        for (Eigen::Index n = 0; n < e.size(); ++n) {
          const RangeTraits traits{sigma[n], noise.nlos_odds[n]};
          sum += noise.range_weight[n] * annealed(kind, loss.annealing, e[n], traits).rho;
        }
      },
      loss.kind);
  for (int n = 1; n < states.places.rows(); ++n) {
    if (!layout.is_stepped_to(n)) continue;
    sum += 0.5 * step_to(n, layout, states, noise.step_sigma.row(n)).residual.squaredNorm();
  }
  return sum + prior_cost(layout.walks(), states, noise);
}

WalkSystem linearized(const WalkLayout& layout, const WalkStates& states, const WalkNoise& noise,
                      const Loss& loss, const Column* height_curvature, const Marks* without_steps_to) {
  WalkSystem out(layout);
  add_ranges(out, layout, states, noise, loss, height_curvature);
  add_priors(out, layout, states, noise);
  out.cost += prior_cost(layout.walks(), states, noise);
  for (int n = 1; n < states.places.rows(); ++n) {
    if (!layout.is_stepped_to(n) || (without_steps_to != nullptr && (*without_steps_to)[n])) continue;
    const SlamStep step = step_to(n, layout, states, noise.step_sigma.row(n));
    out.cost += 0.5 * step.residual.squaredNorm();
    add_step(out, layout, step);
  }
  return out;
}

}  // namespace synchronizar
