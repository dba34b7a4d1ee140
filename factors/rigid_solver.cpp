#include "factors/rigid_solver.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "factors/gauss_newton.h"
#include "factors/range_block.h"

namespace synchronizar {

namespace {

constexpr double kNoSigma = 1e6;           // m: of a height that a prior tells nothing of
constexpr double kLeastInformation = 0.1;  // share of it that is left where the cost bends downwards

pair_sums::Place place_of(const Frames& frames, int user) {
  const auto f = frames.row(user);
  return pair_sums::Place(UserPose{f[0], f[1], f[3], f[2]});
}

std::vector<pair_sums::Place> places_of(const Frames& frames) {
  std::vector<pair_sums::Place> out;
  out.reserve(static_cast<size_t>(frames.rows()));
  for (int u = 0; u < frames.rows(); ++u) out.push_back(place_of(frames, u));
  return out;
}

std::vector<Eigen::Index> counts_of(const Numbers& first) {
  std::vector<Eigen::Index> out;
  for (Eigen::Index p = 0; p + 1 < first.size(); ++p) out.push_back(first[p + 1] - first[p]);
  return out;
}

using Lower = Eigen::LLT<Eigen::MatrixXd, Eigen::Lower>;

}  // namespace

RigidSolver::RigidSolver(RigidRanges ranges, Marks active, int reference, RigidPriors priors,
                         NlosMixture loss)
    : ranges_(std::move(ranges)),
      active_(std::move(active)),
      at_(Numbers::Constant(active_.size(), -1)),
      priors_(std::move(priors)),
      height_weight_((active_ && priors_.survey.col(0).array().isNaN())
                         .select(priors_.height.array().square().inverse(), 0.0)),
      height_weights_(height_weight_.sum()),
      loss_(loss),
      columns_(counts_of(ranges_.first)) {
  for (int u = 0; u < active_.size(); ++u) {
    if (!active_[u] || u == reference) continue;
    at_[u] = variables_;
    variables_ += 4;
  }
  for (Eigen::Index p = 0; p < pairs(); ++p) {
    const Eigen::Index begin = ranges_.first[p], count = ranges_.first[p + 1] - begin;
    columns_.fill(p, ranges_.i.middleRows(begin, count), ranges_.j.middleRows(begin, count),
                  ranges_.measured.segment(begin, count), ranges_.sigma.segment(begin, count));
  }
}

Eigen::ArrayXd RigidSolver::late_density(const Column& nlos_odds) const {
  Eigen::ArrayXd out = Eigen::ArrayXd::Zero(columns_.rows());
  for (Eigen::Index p = 0; p < pairs(); ++p) {
    const Eigen::Index begin = ranges_.first[p], count = ranges_.first[p + 1] - begin;
    columns_.fill_late(p, ranges_.sigma.segment(begin, count), nlos_odds.segment(begin, count), loss_, out);
  }
  return out;
}

Column RigidSolver::residuals(const Frames& frames) const {
  Column out(size());
  for (Eigen::Index p = 0; p < pairs(); ++p) {
    const pair_sums::Place i = place_of(frames, ranges_.user_i[p]), j = place_of(frames, ranges_.user_j[p]);
    const double between_x = i.x - j.x, between_y = i.y - j.y, between_z = i.z - j.z;
    for (Eigen::Index n = ranges_.first[p]; n < ranges_.first[p + 1]; ++n) {
      const auto a = ranges_.i.row(n), b = ranges_.j.row(n);
      const double x = between_x + i.cos_yaw * a[0] - i.sin_yaw * a[1] - j.cos_yaw * b[0] + j.sin_yaw * b[1];
      const double y = between_y + i.sin_yaw * a[0] + i.cos_yaw * a[1] - j.sin_yaw * b[0] - j.cos_yaw * b[1];
      const double z = between_z + a[2] - b[2];
      out[n] = std::sqrt(x * x + y * y + z * z) - ranges_.measured[n];
    }
  }
  return out;
}

double RigidSolver::mean_height(const Frames& frames) const {
  double sum = 0.0;
  for (Eigen::Index u = 0; u < users(); ++u) {
    if (active_[u]) sum += height_weight_[u] * frames(u, 2);
  }
  return sum / height_weights_;
}

double RigidSolver::prior_cost(const Frames& frames) const {
  const double mean = mean_height(frames), tail = priors_.survey_dof + 3.0;
  double sum = 0.0;
  for (Eigen::Index u = 0; u < users(); ++u) {
    if (!active_[u]) continue;
    sum += height_weight_[u] * (frames(u, 2) - mean) * (frames(u, 2) - mean);
    if (!is_surveyed(u)) continue;
    const double square = (frames.row(u).head<3>() - priors_.survey.row(u)).squaredNorm();
    sum += tail * std::log1p(square / (priors_.survey_sigma[u] * priors_.survey_sigma[u]) / tail);
  }
  return 0.5 * sum;
}

Column RigidSolver::survey_information(const Frames& frames) const {
  const double tail = priors_.survey_dof + 3.0;
  Column out = Column::Zero(users());
  for (Eigen::Index u = 0; u < users(); ++u) {
    if (!active_[u] || !is_surveyed(u)) continue;
    const double square = (frames.row(u).head<3>() - priors_.survey.row(u)).squaredNorm();
    const double variance = priors_.survey_sigma[u] * priors_.survey_sigma[u];
    out[u] = tail / (tail + square / variance) / variance;
  }
  return out;
}

void RigidSolver::linearize(const Frames& frames, const Frames& about, const Column& surveys,
                            const Eigen::ArrayXd& late, double annealing, System& out) const {
  out.matrix.setZero(variables_, variables_);
  out.downwards.setZero(variables_, variables_);
  out.gradient.setZero(variables_);
  out.cost = 0.0;
  out.bends_down = false;
  const double mean = mean_height(frames), in_yaw = 1.0 / (priors_.yaw * priors_.yaw);
  for (Eigen::Index u = 0; u < users(); ++u) {
    const int at = at_[u];
    if (active_[u]) out.cost += 0.5 * height_weight_[u] * (frames(u, 2) - mean) * (frames(u, 2) - mean);
    if (at < 0) continue;
    const bool surveyed = is_surveyed(u);
    const double in_plane = surveyed ? surveys[u] : 1.0 / (priors_.place * priors_.place);
    const double in_height = surveyed ? surveys[u] : height_weight_[u];
    const double x = frames(u, 0) - (surveyed ? priors_.survey(u, 0) : about(u, 0));
    const double y = frames(u, 1) - (surveyed ? priors_.survey(u, 1) : about(u, 1));
    const double z = frames(u, 2) - (surveyed ? priors_.survey(u, 2) : mean);
    const double yaw = wrapped(frames(u, 3) - about(u, 3));
    out.cost += 0.5 * (in_plane * (x * x + y * y) + in_yaw * yaw * yaw);
    if (surveyed) out.cost += 0.5 * in_height * z * z;
    out.gradient.segment<4>(at) << in_plane * x, in_plane * y, in_height * z, in_yaw * yaw;
    out.matrix(at, at) = out.matrix(at + 1, at + 1) = in_plane;
    out.matrix(at + 2, at + 2) = in_height;
    out.matrix(at + 3, at + 3) = in_yaw;
    for (Eigen::Index v = 0; v <= u; ++v) {
      if (at_[v] >= 0)
        out.matrix(at + 2, at_[v] + 2) -= height_weight_[u] * height_weight_[v] / height_weights_;
    }
  }
  const auto places = places_of(frames);
  for (Eigen::Index p = 0; p < pairs(); ++p) {
    const int user_i = ranges_.user_i[p], user_j = ranges_.user_j[p];
    const pair_sums::Sums sums =
        pair_sums::nlos_mixture(columns_, p, places[static_cast<size_t>(user_i)],
                                places[static_cast<size_t>(user_j)], loss_, annealing, late);
    out.cost += sums.cost;
    // By the columns of both users: the direction with its sign, the own moment.
    const std::array<int, 2> at{at_[user_i], at_[user_j]};
    const auto number = [](int end, int column) {
      return static_cast<size_t>(column < 3 ? column : 3 + end);
    };
    const auto sign = [](int end, int column) { return end == 1 && column < 3 ? -1.0 : 1.0; };
    for (int a = 0; a < 2; ++a) {
      if (at[static_cast<size_t>(a)] < 0) continue;
      const int row = at[static_cast<size_t>(a)];
      for (int r = 0; r < 4; ++r) out.gradient[row + r] += sign(a, r) * sums.gradient[number(a, r)];
      for (int b = 0; b < 2; ++b) {
        const int column = at[static_cast<size_t>(b)];
        if (column < 0 || column > row) continue;
        for (int r = 0; r < 4; ++r) {
          for (int c = 0; c < 4; ++c) {
            const size_t one = number(a, r), other = number(b, c);
            out.matrix(row + r, column + c) +=
                sign(a, r) * sign(b, c) * sums.squares[std::min(one, other)][std::max(one, other)];
          }
        }
        Eigen::MatrixXd& bent = sums.bend > 0.0 ? out.matrix : out.downwards;
        bent(row + 2, column + 2) += a == b ? sums.bend : -sums.bend;
      }
    }
    if (sums.bend < 0.0) out.bends_down = true;
  }
}

double RigidSolver::cost(const Frames& frames, const Column& nlos_odds, double most) const {
  const Eigen::ArrayXd late = late_density(nlos_odds);
  const auto places = places_of(frames);
  double sum = prior_cost(frames);
  for (Eigen::Index p = 0; p < pairs() && sum <= most; ++p) {
    sum += pair_sums::nlos_mixture_cost(columns_, p, places[static_cast<size_t>(ranges_.user_i[p])],
                                        places[static_cast<size_t>(ranges_.user_j[p])], loss_, 1.0, late);
  }
  return sum;
}

std::pair<Column, double> RigidSolver::e_step(const Frames& frames, const Bursts& bursts) const {
  const Column whitened = residuals(frames).cwiseQuotient(ranges_.sigma);
  PairsBurstOdds found = burst_nlos_odds(ranges_.first, ranges_.t, whitened, ranges_.sigma, ranges_.nlos_odds,
                                         loss_, bursts, &ranges_.measured);
  return {std::move(found.nlos_odds), found.cost.sum() + prior_cost(frames)};
}

Frames RigidSolver::moved(const Frames& frames, const Column& step, double length) const {
  Frames out = frames;
  for (Eigen::Index u = 0; u < users(); ++u) {
    if (at_[u] < 0) continue;
    out.row(u) += length * step.segment<4>(at_[u]).transpose();
    out(u, 3) = wrapped(out(u, 3));
  }
  return out;
}

Frames RigidSolver::optimize(Frames frames, const Frames& about, const Column& nlos_odds, double annealing,
                             int steps, double gain, const Known& known) const {
  if (steps == 0 || variables_ == 0) return frames;
  const Eigen::ArrayXd late = late_density(nlos_odds);
  const Column surveys = survey_information(frames);
  System here, there;
  linearize(frames, about, surveys, late, annealing, here);
  for (int n = 0; n < steps; ++n) {
    // Where bends make the matrix indefinite they are left out; where rounding does, the step is damped.
    Lower root(here.bends_down ? Eigen::MatrixXd(here.matrix + here.downwards) : here.matrix);
    if (here.bends_down && root.info() != Eigen::Success) root.compute(here.matrix);
    for (double damping = 1e-13; root.info() != Eigen::Success; damping *= 1e3) {
      if (damping > 1.0) return frames;
      Eigen::MatrixXd damped = here.matrix;
      damped.diagonal() *= 1.0 + damping;
      root.compute(damped);
    }
    const Column step = root.solve(here.gradient);
    const double predicted = 0.5 * step.dot(here.gradient);
    if (!(predicted >= gain)) break;
    for (double length = 1.0;; length *= kShorter) {
      if (length < kShortest) return frames;
      Frames candidate = moved(frames, step, -length);
      linearize(candidate, about, surveys, late, annealing, there);
      const double gained = here.cost - there.cost;
      if (!(gained > kSufficient * length * predicted)) continue;
      frames = std::move(candidate);
      std::swap(here, there);
      if (gained < gain || is_known(frames, known)) return frames;
      break;
    }
  }
  return frames;
}

bool RigidSolver::is_known(const Frames& frames, const Known& known) const {
  return std::any_of(known.frames.begin(), known.frames.end(), [&](const Frames& other) {
    for (Eigen::Index u = 0; u < users(); ++u) {
      if (!active_[u]) continue;
      const Eigen::RowVector4d off = frames.row(u) - other.row(u);
      if (!(off.head<3>().cwiseAbs().maxCoeff() < known.same && std::abs(wrapped(off[3])) < known.same))
        return false;
    }
    return true;
  });
}

RigidOptimum RigidSolver::run_em(Frames frames, Column nlos_odds, const Bursts& bursts, double annealing,
                                 const RigidStops& stops) const {
  const Frames about = frames;
  double before = std::numeric_limits<double>::infinity();
  for (int round = 0;; ++round) {
    if (round > 0 && round < stops.rounds && is_known(frames, stops.known))
      return {std::move(frames), std::move(nlos_odds), before};
    auto [odds, cost] = e_step(frames, bursts);
    nlos_odds = std::move(odds);
    const bool given_up = round > 0 && stops.hopeless < cost && cost < before;
    if (round == stops.rounds || before - cost < stops.gain || given_up)
      return {std::move(frames), std::move(nlos_odds), cost};
    before = cost;
    frames = optimize(std::move(frames), about, nlos_odds, annealing, stops.steps, 0.25 * stops.gain);
  }
}

std::vector<Heights> RigidSolver::other_heights(const Frames& frames, const Column& nlos_odds,
                                                double most_above, int most) const {
  std::vector<HeightUser> users;
  for (Eigen::Index u = 0; u < this->users(); ++u) {
    const auto f = frames.row(u);
    const UserPose pose = active_[u] ? UserPose{f[0], f[1], f[3], f[2]} : UserPose{};
    // What was surveyed stays, and tells nothing of the others' mean height.
    users.push_back(is_surveyed(u) ? HeightUser{pose, kNoSigma, false, false}
                                   : HeightUser{pose, priors_.height[u], at_[u] >= 0, false});
  }
  std::vector<RangeBlock> blocks;
  blocks.reserve(static_cast<size_t>(pairs()));
  std::vector<HeightPair> all;
  for (Eigen::Index p = 0; p < pairs(); ++p) {
    const Eigen::Index begin = ranges_.first[p], count = ranges_.first[p + 1] - begin;
    blocks.emplace_back(ranges_.i.middleRows(begin, count), ranges_.j.middleRows(begin, count),
                        ranges_.measured.segment(begin, count), ranges_.sigma.segment(begin, count),
                        nlos_odds.segment(begin, count));
    const int i = ranges_.user_i[p], j = ranges_.user_j[p];
    all.push_back({i, j, &blocks.back()});
    users[static_cast<size_t>(i)].present = users[static_cast<size_t>(j)].present = true;
  }
  return search_heights(users, all, loss_, most_above, most);
}

Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor> RigidSolver::covariances(
    const Frames& frames, const Column& nlos_odds) const {
  System system;
  linearize(frames, frames, survey_information(frames), late_density(nlos_odds), 1.0, system);
  Lower root(system.matrix);
  // Where it is singular to rounding, what is not known gets a large covariance all the same.
  double damping = 1e-12;
  while (root.info() != Eigen::Success && damping < 1.0) {
    Eigen::MatrixXd damped = system.matrix;
    damped.diagonal() *= 1.0 + damping;
    root.compute(damped);
    damping *= 1e2;
  }
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Identity(variables_, variables_);
  if (!system.bends_down) {
    root.solveInPlace(covariance);
  } else if (Lower((1.0 - kLeastInformation) * system.matrix + system.downwards).info() == Eigen::Success) {
    Lower(system.matrix + system.downwards).solveInPlace(covariance);
  } else {
    // NOLINTNEXTLINE(misc-const-correctness): solveInPlace takes a const reference and writes to it.
    Eigen::MatrixXd bent = system.downwards.selfadjointView<Eigen::Lower>();
    root.matrixL().solveInPlace(bent);
    root.matrixL().transpose().solveInPlace<Eigen::OnTheRight>(bent);
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> of(bent);
    Eigen::MatrixXd errors = of.eigenvectors();
    root.matrixL().transpose().solveInPlace(errors);
    const Column information = (1.0 + of.eigenvalues().array()).cwiseMax(kLeastInformation);
    covariance = errors * information.cwiseInverse().asDiagonal() * errors.transpose();
  }
  Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor> out =
      Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>::Zero(4 * users(), 4);
  for (Eigen::Index u = 0; u < users(); ++u) {
    if (at_[u] < 0) continue;
    const Eigen::Matrix4d own = covariance.block<4, 4>(at_[u], at_[u]);
    out.middleRows<4>(4 * u) = 0.5 * (own + own.transpose());
  }
  return out;
}

}  // namespace synchronizar
