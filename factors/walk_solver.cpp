#include "factors/walk_solver.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "factors/gauss_newton.h"
#include "factors/kept_walks.h"
#include "factors/walk_cost.h"
#include "factors/walk_ranges.h"

namespace synchronizar {

namespace {

// The part of a vector, which is by groups, that belongs to a variable of some size.
template <int size>
auto part(const BorderedEnvelope::Sides& of, const Where& at) {
  return of[static_cast<size_t>(at.group)].block<size, 1>(at.offset, 0).transpose();
}

WalkStates moved(const WalkLayout& layout, const WalkStates& states, const BorderedEnvelope::Sides& step,
                 double length) {
  const Walks& walks = layout.walks();
  WalkStates out = states;
  for (Eigen::Index n = 0; n < out.places.rows(); ++n) {
    const Where& at = layout.keyframe(n);
    if (at.group < 0) continue;
    out.places.row(n) += length * part<4>(step, at);
    out.places(n, 3) = wrapped(out.places(n, 3));
  }
  for (Eigen::Index u = 0; u < walks.users; ++u) {
    out.calibration.row(u) += length * part<3>(step, layout.device(u));
  }
  for (Eigen::Index v = 0; v < out.lasting.size(); ++v) {
    out.lasting[v] += length * part<1>(step, layout.lasting(v)).value();
  }
  const int first = walks.first[walks.reference];
  out.places(first, 2) = std::exp(out.calibration(walks.reference, 0)) * walks.slam(first, 2);
  return out;
}

// Decomposes the matrix of a system, linearised at some states, for a step from there; false if it cannot.
// Where bends make the matrix indefinite they are left out; where rounding does, the step is damped.
bool factorize_for_step(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
                        const WalkNoise& noise, const Loss& loss) {
  if (!system.downwards.empty()) {
    BorderedEnvelope without = system.matrix;
    for (const HeightBend& bend : system.downwards) add_bend(system, layout, states, bend);
    if (system.matrix.factorize()) return true;
    system.matrix = std::move(without);
  }
  double damping = 0.0;
  while (!system.matrix.factorize()) {
    if (damping > 1.0) return false;
    system = linearized(layout, states, noise, loss);
    system.matrix.damp(1.0 + damping);
    damping = 1e3 * std::max(damping, 1e-13);
  }
  return true;
}

// The decomposition at a local optimum. Where the matrix is singular to rounding, what is not known gets a
// large covariance all the same.
BorderedEnvelope factorized_at_optimum(const WalkLayout& layout, const WalkStates& states,
                                       const WalkNoise& noise, const Loss& loss,
                                       const Column& height_curvature) {
  BorderedEnvelope matrix = linearized(layout, states, noise, loss, &height_curvature).matrix;
  double damping = 1e-12;
  while (!matrix.factorize() && damping < 1.0) {
    matrix = linearized(layout, states, noise, loss, &height_curvature).matrix;
    matrix.damp(1.0 + damping);
    damping *= 1e2;
  }
  return matrix;
}

}  // namespace

WalkSolver::WalkSolver(Walks walks) : layout_(std::move(walks)) {}

Column WalkSolver::residuals(const WalkStates& states, const Column& assumed_clock) const {
  return range_residuals(layout_, states, assumed_clock);
}

double WalkSolver::cost(const WalkStates& states, const WalkNoise& noise, const Loss& loss) const {
  return walk_cost(layout_, states, noise, loss);
}

WalkStates WalkSolver::gradient(const WalkStates& states, const WalkNoise& noise, const Loss& loss) const {
  const auto gradient = linearized(layout_, states, noise, loss).gradient;
  WalkStates out{WalkPlaces::Zero(states.places.rows(), 4), ThreeColumns::Zero(walks().users, 3),
                 Column::Zero(walks().follows.size())};
  for (Eigen::Index n = 0; n < states.places.rows(); ++n) {
    const Where& at = layout_.keyframe(n);
    if (at.group >= 0) out.places.row(n) = part<4>(gradient, at);
  }
  for (Eigen::Index u = 0; u < walks().users; ++u) {
    out.calibration.row(u) = part<3>(gradient, layout_.device(u));
  }
  for (Eigen::Index v = 0; v < out.lasting.size(); ++v) {
    out.lasting[v] = part<1>(gradient, layout_.lasting(v)).value();
  }
  return out;
}

WalkStates WalkSolver::optimize(WalkStates states, const WalkNoise& noise, const Loss& loss, int steps,
                                double gain) const {
  if (steps == 0) return states;
  WalkSystem system = linearized(layout_, states, noise, loss);
  for (int n = 0; n < steps; ++n) {
    const double here = system.cost;
    if (!factorize_for_step(system, layout_, states, noise, loss)) return states;
    BorderedEnvelope::Sides step = system.gradient;
    system.matrix.solve(step);
    double predicted = 0.0;
    for (size_t g = 0; g < step.size(); ++g)
      predicted += 0.5 * step[g].cwiseProduct(system.gradient[g]).sum();
    if (!(predicted >= gain)) break;
    double length = 1.0;
    while (true) {
      WalkStates candidate = moved(layout_, states, step, -length);
      // Full steps are mostly taken: where they lead is linearised at once.
      const bool at_once = length == 1.0 && n + 1 < steps;
      if (at_once) system = linearized(layout_, candidate, noise, loss);
      const double gained = here - (at_once ? system.cost : cost(candidate, noise, loss));
      if (gained > kSufficient * length * predicted) {
        states = std::move(candidate);
        if (gained < gain || n + 1 == steps) return states;
        if (!at_once) system = linearized(layout_, states, noise, loss);
        break;
      }
      length *= kShorter;
      if (length < kShortest) return states;
    }
  }
  return states;
}

Eigen::MatrixXd WalkSolver::covariance(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                                       const Column& height_curvature, const Numbers& keyframes) const {
  std::vector<std::pair<Where, int>> wanted;  // and how many numbers each has
  for (const int n : keyframes) wanted.emplace_back(layout_.keyframe(n), 4);
  for (int u = 0; u < walks().users; ++u) wanted.emplace_back(layout_.device(u), 3);
  int count = 0;
  for (const auto& [_, size] : wanted) count += size;
  BorderedEnvelope::Sides sides;
  for (const int size : layout_.sizes()) sides.emplace_back(Eigen::MatrixXd::Zero(size, count));
  int column = 0;
  for (const auto& [at, size] : wanted) {
    if (at.group >= 0) {
      sides[static_cast<size_t>(at.group)].block(at.offset, column, size, size).setIdentity();
    }
    column += size;
  }
  factorized_at_optimum(layout_, states, noise, loss, height_curvature).solve(sides);
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(count, count);
  int row = 0;
  for (const auto& [at, size] : wanted) {
    if (at.group >= 0)
      out.middleRows(row, size) = sides[static_cast<size_t>(at.group)].middleRows(at.offset, size);
    row += size;
  }
  return 0.5 * (out + out.transpose());
}

double WalkSolver::log_determinant(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                                   const Column& height_curvature) const {
  return factorized_at_optimum(layout_, states, noise, loss, height_curvature).log_determinant();
}

std::vector<StepNoise> WalkSolver::step_noise(const WalkStates& states, const WalkNoise& noise,
                                              const Loss& loss, const Marks& kept,
                                              const StepNoiseSearch& search) const {
  std::vector<StepNoise> out;
  for (const double factor : search.tried) {
    out.push_back({Eigen::MatrixXd::Constant(walks().users, 2, factor), 0.0, 0.0});
  }
  const KeptRows rows = kept_rows(walks(), kept);
  if (rows.users.empty()) return out;
  const Walks its_walks = kept_walks(walks(), rows);
  const WalkStates its_states = kept_states(states, rows);
  const WalkNoise its_noise = kept_noise(noise, rows, its_walks, its_states);
  StepNoiseSearch its_search = search;
  its_search.counted = search.counted(rows.keyframes);
  // The first keyframe that stays of a user has no step that leads to it.
  for (int u = 0; u < its_walks.users; ++u) its_search.counted[its_walks.first[u]] = false;
  const auto found = walk_step_noise(WalkLayout(its_walks), its_states, its_noise, loss, its_search);
  for (size_t b = 0; b < out.size(); ++b) {
    out[b].factors(rows.users, Eigen::all) = found[b].factors;
    out[b].evidence = found[b].evidence;
    out[b].determined = found[b].determined;
  }
  return out;
}

}  // namespace synchronizar
