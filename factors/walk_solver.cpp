#include "factors/walk_solver.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "factors/gauss_newton.h"

namespace synchronizar {

static constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
static constexpr double kHopeless =
    10.0;                        // log evidence: whose common factor has so much less is not refined
static constexpr int kBias = 5;  // column of the first device's bias there
static constexpr int kLast = 2 * kOwnColumns;  // column of the residuals in a pair's squares

// ---- the matrix ----

BorderedEnvelope::BorderedEnvelope(std::vector<int> sizes, std::vector<int> first)
    : sizes_(std::move(sizes)), first_(std::move(first)) {
  for (int a = 0; a < groups(); ++a) {
    begin_.push_back(blocks_.size());
    for (int b = from(a); b <= a; ++b) blocks_.emplace_back(Eigen::MatrixXd::Zero(size(a), size(b)));
  }
}

void BorderedEnvelope::damp(double factor) {
  for (int a = 0; a < groups(); ++a) block(a, a).diagonal() *= factor;
}

bool BorderedEnvelope::factorize() {
  for (int a = 0; a < groups(); ++a) {
    for (int b = from(a); b < a; ++b) {
      Eigen::MatrixXd& here = block(a, b);
      for (int c = std::max(from(a), from(b)); c < b; ++c) {
        here.noalias() -= block(a, c) * block(b, c).transpose();
      }
      block(b, b).triangularView<Eigen::Lower>().transpose().solveInPlace<Eigen::OnTheRight>(here);
    }
    Eigen::MatrixXd& own = block(a, a);
    for (int c = from(a); c < a; ++c) own.selfadjointView<Eigen::Lower>().rankUpdate(block(a, c), -1.0);
    if (Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>>(own).info() != Eigen::Success) return false;
  }
  return true;
}

double BorderedEnvelope::log_determinant() const {
  double sum = 0.0;
  for (int a = 0; a < groups(); ++a) sum += block(a, a).diagonal().array().log().sum();
  return 2.0 * sum;
}

void BorderedEnvelope::solve(Sides& sides) const {
  const auto of = [&](int group) -> Eigen::MatrixXd& { return sides[static_cast<size_t>(group)]; };
  for (int a = 0; a < groups(); ++a) {
    for (int b = from(a); b < a; ++b) of(a).noalias() -= block(a, b) * of(b);
    block(a, a).triangularView<Eigen::Lower>().solveInPlace(of(a));
  }
  for (int a = groups() - 1; a >= 0; --a) {
    block(a, a).triangularView<Eigen::Lower>().transpose().solveInPlace(of(a));
    for (int b = from(a); b < a; ++b) of(b).noalias() -= block(a, b).transpose() * of(a);
  }
}

BorderedEnvelope BorderedEnvelope::inverse() const {
  // Takahashi, Fagan and Chin (PICA 1973): from the last group to the first, each from those after it.
  BorderedEnvelope out(sizes_, first_);
  std::vector<std::vector<int>> after(sizes_.size());
  for (int a = 0; a < groups(); ++a) {
    for (int b = from(a); b < a; ++b) after[static_cast<size_t>(b)].push_back(a);
  }
  for (int g = groups() - 1; g >= 0; --g) {
    const auto& others = after[static_cast<size_t>(g)];
    const auto own = block(g, g).triangularView<Eigen::Lower>();
    Sides by_own;
    for (const int k : others) {
      by_own.push_back(block(k, g));
      own.solveInPlace<Eigen::OnTheRight>(by_own.back());
    }
    Eigen::MatrixXd root = Eigen::MatrixXd::Identity(size(g), size(g));
    own.solveInPlace(root);
    Eigen::MatrixXd& diagonal = out.block(g, g);
    diagonal.noalias() = root.transpose() * root;
    for (const int i : others) {
      Eigen::MatrixXd& here = out.block(i, g);
      for (size_t n = 0; n < others.size(); ++n) {
        const int k = others[n];
        if (i >= k) {
          here.noalias() -= out.block(i, k) * by_own[n];
        } else {
          here.noalias() -= out.block(k, i).transpose() * by_own[n];
        }
      }
    }
    for (size_t n = 0; n < others.size(); ++n) {
      diagonal.noalias() -= by_own[n].transpose() * out.block(others[n], g);
    }
  }
  return out;
}

// ---- the variables ----

WalkSolver::WalkSolver(Walks walks) : walks_(std::move(walks)) {
  const Eigen::Index count = walks_.first[walks_.users];
  user_.resize(count);
  keyframe_at_.resize(static_cast<size_t>(count));
  device_at_.resize(static_cast<size_t>(walks_.users));
  std::vector<int> moving, standing;
  for (int u = 0; u < walks_.users; ++u) {
    const int begin = walks_.first[u], end = walks_.first[u + 1];
    user_.segment(begin, end - begin).setConstant(u);
    for (int n = begin + (u == walks_.reference ? 1 : 0); n < end; ++n) {
      (end - begin > 1 ? moving : standing).push_back(n);
    }
  }
  // Groups by time: a new one where a user would be in one twice.
  std::sort(moving.begin(), moving.end(),
            [&](int a, int b) { return walks_.t[a] < walks_.t[b] || (walks_.t[a] == walks_.t[b] && a < b); });
  std::vector<int> last_group(static_cast<size_t>(walks_.users), -1);
  for (const int n : moving) {
    int& last = last_group[static_cast<size_t>(user_[n])];
    if (sizes_.empty() || last == static_cast<int>(sizes_.size()) - 1) sizes_.push_back(0);
    last = static_cast<int>(sizes_.size()) - 1;
    keyframe_at_[static_cast<size_t>(n)] = {last, sizes_.back()};
    sizes_.back() += 4;
  }
  const int border = static_cast<int>(sizes_.size());
  sizes_.push_back(0);
  const auto in_border = [&](int size) {
    sizes_.back() += size;
    return Where{border, sizes_.back() - size};
  };
  for (const int n : standing) keyframe_at_[static_cast<size_t>(n)] = in_border(4);
  for (Where& at : device_at_) at = in_border(3);
  shared_at_ = in_border(3);
  mean_height_at_ = in_border(1);

  // A lasting error is in the group of the later end of its first range.
  lasting_at_.resize(static_cast<size_t>(walks_.follows.size()));
  const auto of_keyframe = [&](int n) -> const Where& { return keyframe_at_[static_cast<size_t>(n)]; };
  for (Eigen::Index n = 0; n < walks_.lasting.size(); ++n) {
    Where& at = lasting_at_[static_cast<size_t>(walks_.lasting[n])];
    if (at.group >= 0) continue;
    int group = -1;
    for (const int key : {walks_.keyframe_i[n], walks_.keyframe_j[n]}) {
      if (of_keyframe(key).group < border) group = std::max(group, of_keyframe(key).group);
    }
    if (group < 0) group = border;
    at = {group, sizes_[static_cast<size_t>(group)]++};
  }

  connected_from_.resize(sizes_.size());
  std::iota(connected_from_.begin(), connected_from_.end(), 0);
  connected_from_.back() = 0;
  const auto connect = [&](const Where& at, const Where& other) {
    if (at.group < 0 || other.group < 0 || at.group == border || other.group == border) return;
    int& from = connected_from_[static_cast<size_t>(std::max(at.group, other.group))];
    from = std::min({from, at.group, other.group});
  };
  for (Eigen::Index n = 0; n < walks_.measured.size(); ++n)
    connect(of_keyframe(walks_.keyframe_i[n]), of_keyframe(walks_.keyframe_j[n]));
  for (int n = 1; n < count; ++n) {
    if (user_[n] == user_[n - 1]) connect(of_keyframe(n), of_keyframe(n - 1));
  }
  for (Eigen::Index n = 0; n < walks_.lasting.size(); ++n) {
    const Where& at = lasting_at_[static_cast<size_t>(walks_.lasting[n])];
    connect(at, of_keyframe(walks_.keyframe_i[n]));
    connect(at, of_keyframe(walks_.keyframe_j[n]));
  }
  for (Eigen::Index v = 0; v < walks_.follows.size(); ++v) {
    if (walks_.follows[v] < 0) continue;
    connect(lasting_at_[static_cast<size_t>(v)], lasting_at_[static_cast<size_t>(walks_.follows[v])]);
  }
}

template <class Block>
void WalkSolver::System::add(const Where& a, const Where& b, const Block& values) {
  if (a.group < 0 || b.group < 0) return;
  constexpr int kRows = Block::RowsAtCompileTime, kColumns = Block::ColsAtCompileTime;
  if (a.group > b.group || (a.group == b.group && a.offset >= b.offset)) {
    matrix.block(a.group, b.group).block<kRows, kColumns>(a.offset, b.offset) += values;
  } else {
    matrix.block(b.group, a.group).block<kColumns, kRows>(b.offset, a.offset) += values.transpose();
  }
}

template <class Block>
void WalkSolver::System::add_gradient(const Where& at, const Block& values) {
  if (at.group < 0) return;
  gradient[static_cast<size_t>(at.group)].block<Block::RowsAtCompileTime, 1>(at.offset, 0) += values;
}

WalkSolver::System WalkSolver::zero() const {
  System out{BorderedEnvelope(sizes_, connected_from_), {}, 0.0, {}};
  for (const int size : sizes_) out.gradient.emplace_back(Eigen::MatrixXd::Zero(size, 1));
  return out;
}

double WalkSolver::height_by_scale(int keyframe, const WalkStates& states) const {
  if (keyframe_at_[static_cast<size_t>(keyframe)].group >= 0) return 0.0;
  return std::exp(states.calibration(user_[keyframe], 0)) * walks_.slam(keyframe, 2);
}

void WalkSolver::bend(System& system, const Bend& by, const WalkStates& states) const {
  // The variable by which each end's height moves, and how far.
  const auto height_of = [&](int key) -> std::pair<Where, double> {
    Where at = keyframe_at_[static_cast<size_t>(key)];
    double moves = 1.0;
    if (at.group >= 0) {
      at.offset += 2;
    } else {
      at = device_at_[static_cast<size_t>(user_[key])];
      moves = height_by_scale(key, states);
    }
    return {at, moves};
  };
  const auto [i, by_i] = height_of(by.key_i);
  const auto [j, by_j] = height_of(by.key_j);
  using One = Eigen::Matrix<double, 1, 1>;
  system.add(i, i, One(by.information * by_i * by_i));
  system.add(j, j, One(by.information * by_j * by_j));
  system.add(i, j, One(-by.information * by_i * by_j));
}

double WalkSolver::height_of_origin(int user, const WalkStates& states) const {
  const int begin = walks_.first[user];
  return states.places(begin, 2) - std::exp(states.calibration(user, 0)) * walks_.slam(begin, 2);
}

WalkStates WalkSolver::moved(const WalkStates& states, const BorderedEnvelope::Sides& step,
                             double length) const {
  WalkStates out = states;
  for (Eigen::Index n = 0; n < out.places.rows(); ++n) {
    const Where& at = keyframe_at_[static_cast<size_t>(n)];
    if (at.group < 0) continue;
    out.places.row(n) += length * step[static_cast<size_t>(at.group)].block<4, 1>(at.offset, 0).transpose();
    out.places(n, 3) = wrapped(out.places(n, 3));
  }
  for (Eigen::Index u = 0; u < walks_.users; ++u) {
    const Where& at = device_at_[static_cast<size_t>(u)];
    out.calibration.row(u) +=
        length * step[static_cast<size_t>(at.group)].block<3, 1>(at.offset, 0).transpose();
  }
  for (size_t v = 0; v < lasting_at_.size(); ++v) {
    const Where& at = lasting_at_[v];
    out.lasting[static_cast<Eigen::Index>(v)] += length * step[static_cast<size_t>(at.group)](at.offset, 0);
  }
  const int first = walks_.first[walks_.reference];
  out.places(first, 2) = std::exp(out.calibration(walks_.reference, 0)) * walks_.slam(first, 2);
  return out;
}

// ---- ranges ----

std::vector<DeviceAtKeyframe> WalkSolver::devices(const WalkStates& states,
                                                  const Column& assumed_clock) const {
  std::vector<DeviceAtKeyframe> out;
  out.reserve(static_cast<size_t>(states.places.rows()));
  for (Eigen::Index n = 0; n < states.places.rows(); ++n) {
    const auto p = states.places.row(n);
    const auto c = states.calibration.row(user_[n]);
    out.emplace_back(UserPose{p[0], p[1], p[3], p[2]},
                     Calibration{c[0], c[1], c[2] - assumed_clock[user_[n]]});
  }
  return out;
}

double WalkSolver::lasting_of(Eigen::Index range, const WalkStates& states) const {
  return walks_.lasting.size() == 0 ? 0.0 : states.lasting[walks_.lasting[range]];
}

Column WalkSolver::residuals(const WalkStates& states, const Column& assumed_clock) const {
  const auto at = devices(states, assumed_clock);
  Column out(walks_.measured.size());
  for (Eigen::Index n = 0; n < out.size(); ++n) {
    const DeviceAtKeyframe& i = at[static_cast<size_t>(walks_.keyframe_i[n])];
    const DeviceAtKeyframe& j = at[static_cast<size_t>(walks_.keyframe_j[n])];
    const Vector3 between = i.place() + i.arm(walks_.i.at(n)) - j.place() - j.arm(walks_.j.at(n));
    out[n] = between.norm() + i.range_bias() + j.range_bias() + lasting_of(n, states) - walks_.measured[n];
  }
  return out;
}

void WalkSolver::add_ranges(System& system, const WalkStates& states, const WalkNoise& noise,
                            const Loss& loss, const Column* height_curvature) const {
  const auto at = devices(states, noise.assumed_clock);
  const Eigen::Index n = walks_.measured.size();
  RowSquares sum;
  std::visit(
      [&](const auto& kind) {
        for (Eigen::Index begin = 0, end = 0; begin < n; begin = end) {
          // A run of ranges between the same two keyframes, with the same lasting error.
          const int lasting = walks_.lasting.size() == 0 ? -1 : walks_.lasting[begin];
          const double longer = lasting_of(begin, states);
          const int key_i = walks_.keyframe_i[begin], key_j = walks_.keyframe_j[begin];
          const DeviceAtKeyframe &i = at[static_cast<size_t>(key_i)], &j = at[static_cast<size_t>(key_j)];
          sum.clear();
          double height_information = 0.0, replaced = 0.0;
          for (; end < n && walks_.keyframe_i[end] == key_i && walks_.keyframe_j[end] == key_j &&
                 (lasting < 0 || walks_.lasting[end] == lasting);
               ++end) {
            const RangeTerms terms =
                add_range(sum, kind, loss.annealing, i, j, walks_.i.at(end), walks_.j.at(end),
                          walks_.measured[end] - longer, {walks_.sigma[end], noise.nlos_odds[end]},
                          noise.range_weight[end]);
            system.cost += terms.loss;
            height_information += terms.height_curvature;
            if (height_curvature != nullptr) replaced += (*height_curvature)[end];
          }
          if (height_curvature != nullptr) height_information = replaced;
          PairSquares squares = sum.of_columns();
          using Columns = std::array<std::pair<Where, int>, 2>;
          const Columns places{{{keyframe_at_[static_cast<size_t>(key_i)], 0},
                                {keyframe_at_[static_cast<size_t>(key_j)], kOwnColumns}}};
          // A keyframe that is fixed moves in height by its device's scale.
          for (const auto& [first, key] : {std::pair(0, key_i), std::pair(kOwnColumns, key_j)}) {
            const double by_scale = height_by_scale(key, states);
            if (by_scale == 0.0) continue;
            squares.col(first + 4) += by_scale * squares.col(first + 2);
            squares.row(first + 4) += by_scale * squares.row(first + 2);
          }
          const Columns of_devices{{{device_at_[static_cast<size_t>(user_[key_i])], 4},
                                    {device_at_[static_cast<size_t>(user_[key_j])], kOwnColumns + 4}}};
          for (const auto& [a, row] : of_devices) {
            system.add(a, a, squares.block<3, 3>(row, row));
            system.add_gradient(a, squares.block<3, 1>(row, kLast));
            for (const auto& [b, column] : places) system.add(a, b, squares.block<3, 4>(row, column));
          }
          system.add(of_devices[0].first, of_devices[1].first, squares.block<3, 3>(4, kOwnColumns + 4));
          for (const auto& [a, row] : places) {
            system.add(a, a, squares.block<4, 4>(row, row));
            system.add_gradient(a, squares.block<4, 1>(row, kLast));
          }
          system.add(places[0].first, places[1].first, squares.block<4, 4>(0, kOwnColumns));
          if (lasting >= 0) {  // which makes a range longer just as a bias does
            const Where& at_lasting = lasting_at_[static_cast<size_t>(lasting)];
            system.add(at_lasting, at_lasting, squares.block<1, 1>(kBias, kBias));
            system.add_gradient(at_lasting, squares.block<1, 1>(kBias, kLast));
            for (const auto& [a, row] : places) system.add(at_lasting, a, squares.block<1, 4>(kBias, row));
            for (const auto& [a, row] : of_devices)
              system.add(at_lasting, a, squares.block<1, 3>(kBias, row));
          }
          const Bend by{key_i, key_j, height_information};
          if (height_information > 0.0) {
            bend(system, by, states);
          } else if (height_information < 0.0) {
            system.downwards.push_back(by);
          }
        }
      },
      loss.kind);
}

// ---- SLAM's steps ----

struct WalkSolver::Step {
  Eigen::Vector4d residual;           // whitened: x, y, z, yaw
  Eigen::Matrix4d by_here, by_there;  // the keyframe of the step's begin, and that of its end
  Eigen::Vector4d by_scale;
  int here, there;
};

WalkSolver::Step WalkSolver::step_to(int keyframe, const WalkStates& states, const Vector3& sigma) const {
  const int here = keyframe - 1;
  const auto p = states.places.row(here), q = states.places.row(keyframe);
  const double s = std::exp(states.calibration(user_[keyframe], 0));
  const double c = std::cos(p[3]) / s, n = std::sin(p[3]) / s, dx = q[0] - p[0], dy = q[1] - p[1];
  const double x = c * dx + n * dy, y = -n * dx + c * dy, z = (q[2] - p[2]) / s;
  const Vector3 slam = walks_.slam.row(keyframe) - walks_.slam.row(here);
  Step out;
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
  out.by_scale += height_by_scale(here, states) * out.by_here.col(2);
  const Eigen::Vector4d root(1.0 / sigma[0], 1.0 / sigma[0], 1.0 / sigma[1], 1.0 / sigma[2]);
  out.residual = root.cwiseProduct(out.residual);
  out.by_here = root.asDiagonal() * out.by_here;
  out.by_there = root.asDiagonal() * out.by_there;
  out.by_scale = root.cwiseProduct(out.by_scale);
  return out;
}

void WalkSolver::add(System& system, const Step& step) const {
  const Where& here = keyframe_at_[static_cast<size_t>(step.here)];
  const Where& there = keyframe_at_[static_cast<size_t>(step.there)];
  system.add(here, here, (step.by_here.transpose() * step.by_here).eval());
  system.add(there, there, (step.by_there.transpose() * step.by_there).eval());
  system.add(there, here, (step.by_there.transpose() * step.by_here).eval());
  system.add_gradient(here, (step.by_here.transpose() * step.residual).eval());
  system.add_gradient(there, (step.by_there.transpose() * step.residual).eval());
  const Where& scale = device_at_[static_cast<size_t>(user_[step.there])];
  const Eigen::RowVector4d by_scale = step.by_scale.transpose();
  system.add(scale, here, (by_scale * step.by_here).eval());
  system.add(scale, there, (by_scale * step.by_there).eval());
  system.add(scale, scale, (by_scale * step.by_scale).eval());
  system.add_gradient(scale, (by_scale * step.residual).eval());
}

// ---- priors ----

Vector3 WalkSolver::shared_calibration(const WalkStates& states, const WalkNoise& noise) const {
  Vector3 weight = noise.shared_sigma.cwiseAbs2().cwiseInverse(), sum = Vector3::Zero();
  for (Eigen::Index u = 0; u < walks_.users; ++u) {
    const Vector3 own = noise.device_sigma.row(u).cwiseAbs2().cwiseInverse();
    weight += own;
    sum += own.cwiseProduct(Vector3(states.calibration.row(u)));
  }
  return sum.cwiseQuotient(weight);
}

double WalkSolver::mean_height(const WalkStates& states, const WalkNoise& noise) const {
  double weight = 0.0, sum = 0.0;
  for (int u = 0; u < walks_.users; ++u) {
    if (noise.surveyed[u]) continue;
    const double own = std::pow(noise.height_sigma[u], -2);
    weight += own;
    if (u != walks_.reference) sum += own * height_of_origin(u, states);
  }
  return sum / weight;
}

double WalkSolver::lasting_step(int which, const WalkStates& states, const WalkNoise& noise) const {
  const int before = walks_.follows[which];
  const double decay = walks_.decay[which];
  const double off = states.lasting[which] - (before < 0 ? 0.0 : decay * states.lasting[before]);
  return off / (noise.lasting_sigma[which] * std::sqrt(1.0 - decay * decay));
}

double WalkSolver::prior_cost(const WalkStates& states, const WalkNoise& noise) const {
  const double mean = mean_height(states, noise);
  const Vector3 shared = shared_calibration(states, noise);
  double sum = shared.cwiseQuotient(noise.shared_sigma).squaredNorm();
  for (int u = 0; u < walks_.users; ++u) {
    const Vector3 apart = Vector3(states.calibration.row(u)) - shared;
    sum += apart.cwiseQuotient(Vector3(noise.device_sigma.row(u))).squaredNorm();
    sum += std::pow(states.calibration(u, 1) / noise.known_bias_sigma[u], 2);
    const double height = u == walks_.reference ? 0.0 : height_of_origin(u, states);
    sum += std::pow((height - (noise.surveyed[u] ? noise.about(u, 2) : mean)) / noise.height_sigma[u], 2);
    if (u == walks_.reference) continue;
    const auto off = states.places.row(walks_.first[u]) - noise.about.row(u);
    sum += (off[0] * off[0] + off[1] * off[1]) / (noise.place_sigma[u] * noise.place_sigma[u]);
    sum += std::pow(wrapped(off[3]) / noise.yaw_sigma, 2);
  }
  for (int v = 0; v < walks_.follows.size(); ++v) sum += std::pow(lasting_step(v, states, noise), 2);
  return 0.5 * sum;
}

void WalkSolver::add_priors(System& system, const WalkStates& states, const WalkNoise& noise) const {
  using One = Eigen::Matrix<double, 1, 1>;
  const double mean = mean_height(states, noise);
  const Vector3 shared = shared_calibration(states, noise);
  const Vector3 of_shared = noise.shared_sigma.cwiseAbs2().cwiseInverse();
  system.add(shared_at_, shared_at_, Eigen::Matrix3d(of_shared.asDiagonal()));
  system.add_gradient(shared_at_, Vector3(of_shared.cwiseProduct(shared)));
  for (int u = 0; u < walks_.users; ++u) {
    const Where& device = device_at_[static_cast<size_t>(u)];
    const Vector3 own = noise.device_sigma.row(u).cwiseAbs2().cwiseInverse();
    const Vector3 pull = own.cwiseProduct(Vector3(states.calibration.row(u)) - shared);
    system.add(device, device, Eigen::Matrix3d(own.asDiagonal()));
    system.add(shared_at_, shared_at_, Eigen::Matrix3d(own.asDiagonal()));
    system.add(shared_at_, device, Eigen::Matrix3d(-Eigen::Matrix3d(own.asDiagonal())));
    system.add_gradient(device, pull);
    system.add_gradient(shared_at_, Vector3(-pull));
    const double of_bias = std::pow(noise.known_bias_sigma[u], -2);
    system.add(device, device, Eigen::Matrix3d(Vector3(0.0, of_bias, 0.0).asDiagonal()));
    system.add_gradient(device, Vector3(0.0, of_bias * states.calibration(u, 1), 0.0));
    // Height of the origin: that of the first keyframe without scale times SLAM's.
    const double weight = std::pow(noise.height_sigma[u], -2);
    const bool fixed = u == walks_.reference, by_itself = noise.surveyed[u];
    const double slope =
        weight * ((fixed ? 0.0 : height_of_origin(u, states)) - (by_itself ? noise.about(u, 2) : mean));
    if (!by_itself) {
      system.add(mean_height_at_, mean_height_at_, One(weight));
      system.add_gradient(mean_height_at_, One(-slope));
    }
    if (fixed) continue;
    const int first = walks_.first[u];
    const auto off = states.places.row(first) - noise.about.row(u);
    const double in_plane = std::pow(noise.place_sigma[u], -2), in_yaw = std::pow(noise.yaw_sigma, -2);
    const Where& at = keyframe_at_[static_cast<size_t>(first)];
    system.add(at, at, Eigen::Matrix4d(Eigen::Vector4d(in_plane, in_plane, weight, in_yaw).asDiagonal()));
    system.add_gradient(
        at, Eigen::Vector4d(in_plane * off[0], in_plane * off[1], slope, in_yaw * wrapped(off[3])));
    if (!by_itself) system.add(mean_height_at_, at, Eigen::RowVector4d(0.0, 0.0, -weight, 0.0));
    const double by_scale = -std::exp(states.calibration(u, 0)) * walks_.slam(first, 2);
    system.add(device, device, One(weight * by_scale * by_scale));
    system.add_gradient(device, One(slope * by_scale));
    system.add(device, at, Eigen::RowVector4d(0.0, 0.0, weight * by_scale, 0.0));
    if (!by_itself) system.add(mean_height_at_, device, One(-weight * by_scale));
  }
  for (int v = 0; v < walks_.follows.size(); ++v) {
    const Where& here = lasting_at_[static_cast<size_t>(v)];
    const int before = walks_.follows[v];
    const double decay = walks_.decay[v];
    const double root = 1.0 / (noise.lasting_sigma[v] * std::sqrt(1.0 - decay * decay));
    const double pull = root * lasting_step(v, states, noise);
    system.add(here, here, One(root * root));
    system.add_gradient(here, One(pull));
    if (before < 0) continue;
    const Where& there = lasting_at_[static_cast<size_t>(before)];
    system.add(there, there, One(decay * decay * root * root));
    system.add(here, there, One(-decay * root * root));
    system.add_gradient(there, One(-decay * pull));
  }
}

// ---- the whole ----

double WalkSolver::cost(const WalkStates& states, const WalkNoise& noise, const Loss& loss) const {
  const Column e = residuals(states, noise.assumed_clock).cwiseQuotient(walks_.sigma);
  double sum = 0.0;
  std::visit(
      [&](const auto& kind) {
        for (Eigen::Index n = 0; n < e.size(); ++n) {
          const RangeTraits traits{walks_.sigma[n], noise.nlos_odds[n]};
          sum += noise.range_weight[n] * annealed(kind, loss.annealing, e[n], traits).rho;
        }
      },
      loss.kind);
  for (int n = 1; n < states.places.rows(); ++n) {
    if (user_[n] == user_[n - 1])
      sum += 0.5 * step_to(n, states, noise.step_sigma.row(n)).residual.squaredNorm();
  }
  return sum + prior_cost(states, noise);
}

WalkSolver::System WalkSolver::linearized(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                                          const Column* height_curvature,
                                          const Marks* without_steps_to) const {
  System out = zero();
  add_ranges(out, states, noise, loss, height_curvature);
  add_priors(out, states, noise);
  out.cost += prior_cost(states, noise);
  for (int n = 1; n < states.places.rows(); ++n) {
    const bool is_step = user_[n] == user_[n - 1];
    if (is_step && (without_steps_to == nullptr || !(*without_steps_to)[n])) {
      const Step step = step_to(n, states, noise.step_sigma.row(n));
      out.cost += 0.5 * step.residual.squaredNorm();
      add(out, step);
    }
  }
  return out;
}

WalkStates WalkSolver::gradient(const WalkStates& states, const WalkNoise& noise, const Loss& loss) const {
  const System system = linearized(states, noise, loss);
  WalkStates out{WalkPlaces::Zero(states.places.rows(), 4), ThreeColumns::Zero(walks_.users, 3),
                 Column::Zero(walks_.follows.size())};
  for (Eigen::Index n = 0; n < states.places.rows(); ++n) {
    const Where& at = keyframe_at_[static_cast<size_t>(n)];
    if (at.group < 0) continue;
    out.places.row(n) = system.gradient[static_cast<size_t>(at.group)].block<4, 1>(at.offset, 0).transpose();
  }
  for (Eigen::Index u = 0; u < walks_.users; ++u) {
    const Where& at = device_at_[static_cast<size_t>(u)];
    out.calibration.row(u) =
        system.gradient[static_cast<size_t>(at.group)].block<3, 1>(at.offset, 0).transpose();
  }
  for (size_t v = 0; v < lasting_at_.size(); ++v) {
    const Where& at = lasting_at_[v];
    out.lasting[static_cast<Eigen::Index>(v)] = system.gradient[static_cast<size_t>(at.group)](at.offset, 0);
  }
  return out;
}

WalkStates WalkSolver::optimize(WalkStates states, const WalkNoise& noise, const Loss& loss, int steps,
                                double gain) const {
  if (steps == 0) return states;
  System system = linearized(states, noise, loss);
  for (int n = 0; n < steps; ++n) {
    const double here = system.cost;
    // Where bends make the matrix indefinite they are left out; where rounding does, the step is damped.
    bool solvable = false;
    if (!system.downwards.empty()) {
      BorderedEnvelope without = system.matrix;
      for (const Bend& by : system.downwards) bend(system, by, states);
      solvable = system.matrix.factorize();
      if (!solvable) system.matrix = std::move(without);
    }
    double damping = 0.0;
    while (!solvable && !system.matrix.factorize()) {
      if (damping > 1.0) return states;
      system = linearized(states, noise, loss);
      system.matrix.damp(1.0 + damping);
      damping = 1e3 * std::max(damping, 1e-13);
    }
    BorderedEnvelope::Sides step = system.gradient;
    system.matrix.solve(step);
    double predicted = 0.0;
    for (size_t g = 0; g < step.size(); ++g)
      predicted += 0.5 * step[g].cwiseProduct(system.gradient[g]).sum();
    if (!(predicted >= gain)) break;
    double length = 1.0;
    while (true) {
      WalkStates candidate = moved(states, step, -length);
      // Full steps are mostly taken: where they lead is linearised at once.
      const bool at_once = length == 1.0 && n + 1 < steps;
      if (at_once) system = linearized(candidate, noise, loss);
      const double gained = here - (at_once ? system.cost : cost(candidate, noise, loss));
      if (gained > kSufficient * length * predicted) {
        states = std::move(candidate);
        if (gained < gain || n + 1 == steps) return states;
        if (!at_once) system = linearized(states, noise, loss);
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
  System system = linearized(states, noise, loss, &height_curvature, nullptr);
  std::vector<std::pair<Where, int>> wanted;  // and how many numbers each has
  for (const int n : keyframes) wanted.emplace_back(keyframe_at_[static_cast<size_t>(n)], 4);
  for (const Where& at : device_at_) wanted.emplace_back(at, 3);
  int count = 0;
  for (const auto& [_, size] : wanted) count += size;
  BorderedEnvelope::Sides sides;
  for (const int size : sizes_) sides.emplace_back(Eigen::MatrixXd::Zero(size, count));
  int column = 0;
  for (const auto& [at, size] : wanted) {
    if (at.group >= 0) {
      sides[static_cast<size_t>(at.group)].block(at.offset, column, size, size).setIdentity();
    }
    column += size;
  }
  // Where it is singular to rounding, what is not known gets a large covariance all the same.
  double damping = 1e-12;
  while (!system.matrix.factorize() && damping < 1.0) {
    system = linearized(states, noise, loss, &height_curvature);
    system.matrix.damp(1.0 + damping);
    damping *= 1e2;
  }
  system.matrix.solve(sides);
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
  System system = linearized(states, noise, loss, &height_curvature, nullptr);
  double damping = 1e-12;
  while (!system.matrix.factorize() && damping < 1.0) {
    system = linearized(states, noise, loss, &height_curvature);
    system.matrix.damp(1.0 + damping);
    damping *= 1e2;
  }
  return system.matrix.log_determinant();
}

std::vector<StepNoise> WalkSolver::step_noise(const WalkStates& states, const WalkNoise& noise,
                                              const Loss& loss, const Marks& kept, const Marks& counted,
                                              const Column& tried, double begin, double weight,
                                              int rounds) const {
  // Rows that stay: of keyframes, of users who have any, and of ranges between them.
  std::vector<int> keyframes, users, ranges;
  Numbers new_keyframe = Numbers::Constant(kept.size(), -1);
  Walks part{0, 0, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}};
  std::vector<int> first;
  for (int u = 0; u < walks_.users; ++u) {
    const auto at = static_cast<int>(keyframes.size());
    for (int n = walks_.first[u]; n < walks_.first[u + 1]; ++n) {
      if (!kept[n]) continue;
      new_keyframe[n] = static_cast<int>(keyframes.size());
      keyframes.push_back(n);
    }
    if (static_cast<int>(keyframes.size()) == at) continue;
    if (u == walks_.reference) part.reference = static_cast<int>(users.size());
    users.push_back(u);
    first.push_back(at);
  }
  std::vector<StepNoise> out;
  for (const double factor : tried) {
    out.push_back({Eigen::MatrixXd::Constant(walks_.users, 2, factor), 0.0, 0.0});
  }
  if (users.empty()) return out;
  first.push_back(static_cast<int>(keyframes.size()));
  for (int n = 0; n < walks_.measured.size(); ++n) {
    if (kept[walks_.keyframe_i[n]] && kept[walks_.keyframe_j[n]]) ranges.push_back(n);
  }
  const auto all = Eigen::all;
  const auto antennas = [&](const Antennas& a) {
    return Antennas{a.offset(ranges, all), a.lever(ranges, all), a.velocity(ranges, all)};
  };
  part.users = static_cast<int>(users.size());
  part.first = Eigen::Map<const Numbers>(first.data(), static_cast<Eigen::Index>(first.size()));
  part.t = walks_.t(keyframes);
  part.slam = walks_.slam(keyframes, all);
  part.keyframe_i = new_keyframe(Numbers(walks_.keyframe_i(ranges)));
  part.keyframe_j = new_keyframe(Numbers(walks_.keyframe_j(ranges)));
  part.i = antennas(walks_.i);
  part.j = antennas(walks_.j);
  part.measured = walks_.measured(ranges);
  part.sigma = walks_.sigma(ranges);
  std::vector<int> lasting;
  if (walks_.lasting.size() > 0) {
    Numbers new_lasting = Numbers::Constant(walks_.follows.size(), -1);
    for (const int n : ranges) new_lasting[walks_.lasting[n]] = 0;
    for (int v = 0; v < new_lasting.size(); ++v) {
      if (new_lasting[v] < 0) continue;
      new_lasting[v] = static_cast<int>(lasting.size());
      lasting.push_back(v);
    }
    part.lasting = new_lasting(Numbers(walks_.lasting(ranges)));
    part.follows = walks_.follows(lasting);
    part.decay = walks_.decay(lasting);
    for (Eigen::Index v = 0; v < part.follows.size(); ++v) {
      if (part.follows[v] >= 0) part.follows[v] = new_lasting[part.follows[v]];
      if (part.follows[v] < 0) part.decay[v] = 0.0;
    }
  }
  const WalkStates here{states.places(keyframes, all), states.calibration(users, all),
                        states.lasting(lasting)};
  WalkNoise its = noise;
  its.nlos_odds = noise.nlos_odds(ranges);
  its.range_weight = noise.range_weight(ranges);
  its.step_sigma = noise.step_sigma(keyframes, all);
  its.about.resize(part.users, 4);
  for (int u = 0; u < part.users; ++u) its.about.row(u) = here.places.row(part.first[u]);
  for (int u = 0; u < part.users; ++u) {
    if (noise.surveyed[users[static_cast<size_t>(u)]])
      its.about.row(u) = noise.about.row(users[static_cast<size_t>(u)]);
  }
  its.place_sigma = noise.place_sigma(users);
  its.height_sigma = noise.height_sigma(users);
  its.surveyed = noise.surveyed(users);
  its.known_bias_sigma = noise.known_bias_sigma(users);
  its.device_sigma = noise.device_sigma(users, all);
  its.assumed_clock = noise.assumed_clock(users);
  its.lasting_sigma = noise.lasting_sigma(lasting);
  // The first keyframe that stays of a user has no step that leads to it.
  Marks its_counted = counted(keyframes);
  for (int u = 0; u < part.users; ++u) its_counted[part.first[u]] = false;
  const auto of_part =
      WalkSolver(part).step_noise(here, its, loss, its_counted, tried, begin, weight, rounds);
  for (size_t b = 0; b < out.size(); ++b) {
    out[b].factors(users, all) = of_part[b].factors;
    out[b].evidence = of_part[b].evidence;
    out[b].determined = of_part[b].determined;
  }
  return out;
}

std::vector<StepNoise> WalkSolver::step_noise(const WalkStates& states, const WalkNoise& noise,
                                              const Loss& loss, const Marks& counted, const Column& tried,
                                              double begin, double weight, int rounds) const {
  const System others = linearized(states, noise, loss, nullptr, &counted);
  std::vector<StepNoise> out;
  double most = -std::numeric_limits<double>::infinity();
  for (const double about : tried) {
    out.push_back({Eigen::MatrixXd::Constant(walks_.users, 2, about), 0.0, kUnknown});
    out.back().evidence =
        with_steps(about, out.back().factors, others, states, noise, counted, weight).evidence;
    most = std::max(most, out.back().evidence);
  }
  for (size_t b = 0; b < out.size(); ++b) {
    if (out[b].evidence < most - kHopeless) continue;
    out[b].factors *= begin;
    maximize(tried[static_cast<Eigen::Index>(b)], out[b], others, states, noise, counted, weight, rounds);
  }
  return out;
}

WalkSolver::WithSteps WalkSolver::with_steps(double about, const Eigen::MatrixXd& factors,
                                             const System& others, const WalkStates& states,
                                             const WalkNoise& noise, const Marks& counted,
                                             double weight) const {
  WithSteps out{others.matrix, others.gradient, -std::numeric_limits<double>::infinity()};
  System system = others;
  double squared = 0.0, log_sigma = 0.0;
  Column count = Column::Zero(walks_.users);
  for (int n = 1; n < states.places.rows(); ++n) {
    if (!counted[n]) continue;
    const Vector3 by(factors(user_[n], 0), about, factors(user_[n], 1));
    const Step step = step_to(n, states, noise.step_sigma.row(n).transpose().cwiseProduct(by));
    add(system, step);
    squared += step.residual.squaredNorm();
    count[user_[n]] += 1.0;
  }
  if (!system.matrix.factorize()) return out;
  out.step = system.gradient;
  system.matrix.solve(out.step);
  double gained = 0.0;
  for (size_t g = 0; g < out.step.size(); ++g) gained += out.step[g].col(0).dot(system.gradient[g].col(0));
  for (int u = 0; u < walks_.users; ++u) {
    log_sigma += count[u] * std::log(about);  // of heights
    for (int kind = 0; kind < 2; ++kind) {
      const double many = kind == 0 ? 2.0 : 1.0, ratio = factors(u, kind) / about;
      log_sigma += many * count[u] * std::log(factors(u, kind)) +
                   many * weight * (std::log(ratio) + 0.5 * (1.0 / (ratio * ratio) - 1.0));
    }
  }
  out.evidence = -0.5 * (squared - gained + system.matrix.log_determinant()) - log_sigma;
  out.matrix = std::move(system.matrix);
  return out;
}

void WalkSolver::maximize(double about, StepNoise& out, const System& others, const WalkStates& states,
                          const WalkNoise& noise, const Marks& counted, double weight, int rounds) const {
  Eigen::MatrixXd factors = out.factors;
  Column count = Column::Zero(walks_.users);
  for (int n = 1; n < states.places.rows(); ++n) count[user_[n]] += counted[n] ? 1.0 : 0.0;
  for (int round = 0; round <= rounds; ++round) {
    const auto [matrix, step, evidence] = with_steps(about, factors, others, states, noise, counted, weight);
    if (!std::isfinite(evidence)) return;
    out.factors = factors;
    out.evidence = evidence;
    const BorderedEnvelope covariance = matrix.inverse();
    Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(walks_.users, 2);
    double left = 0.0;
    for (int n = 1; n < states.places.rows(); ++n) {
      if (!counted[n]) continue;
      const Step with = step_to(n, states, noise.step_sigma.row(n).transpose());
      // Residuals in the plane and in heading, at the most likely states, and their variances.
      Eigen::Matrix<double, 4, 9> rows;
      rows << with.by_here, with.by_there, with.by_scale;
      const std::array<const Where*, 3> at{&keyframe_at_[static_cast<size_t>(with.here)],
                                           &keyframe_at_[static_cast<size_t>(with.there)],
                                           &device_at_[static_cast<size_t>(user_[n])]};
      constexpr std::array<int, 3> sizes{4, 4, 1}, begins{0, 4, 8};
      Eigen::Matrix<double, 9, 9> around = Eigen::Matrix<double, 9, 9>::Zero();
      Eigen::Matrix<double, 9, 1> moved = Eigen::Matrix<double, 9, 1>::Zero();
      for (size_t a = 0; a < 3; ++a) {
        if (at[a]->group < 0) continue;
        moved.segment(begins[a], sizes[a]) =
            -step[static_cast<size_t>(at[a]->group)].col(0).segment(at[a]->offset, sizes[a]);
        for (size_t b = 0; b < 3; ++b) {
          if (at[b]->group < 0) continue;
          const bool below = at[a]->group >= at[b]->group;
          const Where &row = *at[below ? a : b], &column = *at[below ? b : a];
          const Eigen::MatrixXd part =
              covariance.block(row.group, column.group)
                  .block(row.offset, column.offset, sizes[below ? a : b], sizes[below ? b : a]);
          if (below) {
            around.block(begins[a], begins[b], sizes[a], sizes[b]) = part;
          } else {
            around.block(begins[a], begins[b], sizes[a], sizes[b]) = part.transpose();
          }
        }
      }
      const Eigen::Vector4d residual = with.residual + rows * moved;
      const Eigen::Vector4d variance = (rows * around * rows.transpose()).diagonal();
      const Eigen::Vector4d square = residual.cwiseAbs2() + variance;
      squares(user_[n], 0) += square[0] + square[1];
      squares(user_[n], 1) += square[3];
      const double place = factors(user_[n], 0), heading = factors(user_[n], 1);
      left += (variance[0] + variance[1]) / (place * place) + variance[2] / (about * about) +
              variance[3] / (heading * heading);
    }
    out.determined = 4.0 * count.sum() - left;
    const double prior = weight * about * about;
    factors.col(0) = ((2.0 * prior + squares.col(0).array()) / (2.0 * (weight + count.array()))).sqrt();
    factors.col(1) = ((prior + squares.col(1).array()) / (weight + count.array())).sqrt();
  }
}

}  // namespace synchronizar
