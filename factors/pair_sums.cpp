#include "factors/pair_sums.h"

#include <array>
#include <cmath>
#include <cstdint>

#include "factors/branchless_loss.h"

namespace synchronizar::pair_sums {
namespace {

using std::size_t;

enum Named : std::uint8_t { kXi, kYi, kZi, kXj, kYj, kZj, kMeasured, kSigma, kPerSigma, kFilled, kNamed };

struct Pair {
  Place i, j;
  double annealing;
};

constexpr int kLanes = 8;
constexpr int kGradient = kNumbers * (kNumbers + 1) / 2, kCost = kGradient + kNumbers, kBend = kCost + 1;

// All sums, each spread over lanes: the squares' upper triangle by rows, the gradient, the cost, the bend.
struct Lanes {
  // NOLINTBEGIN(modernize-avoid-c-arrays): plain arrays, as in add_block.
  double of[kBend + 1][kLanes] = {};
  double product[kLanes] = {1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0};  // its logarithm is a part of the cost
  // NOLINTEND(modernize-avoid-c-arrays)

  SYNCHRONIZAR_INLINE void add_dot(int sum, const double* a, const double* b) {
    for (int n = 0; n < kBlock; n += kLanes) {
      for (int l = 0; l < kLanes; ++l) of[sum][l] += a[n + l] * b[n + l];
    }
  }

  // Logarithms of a block: the exponents now, those of the mantissas' product at the end.
  SYNCHRONIZAR_INLINE void add_logs(const double* x) {
    for (int l = 0; l < kLanes; ++l) {
      double of_lane = product[l], powers = 0.0;
      for (int n = 0; n < kBlock; n += kLanes) {
        const Split split = split_of(x[n + l]);
        of_lane *= split.mantissa;
        powers += split.exponent;
      }
      const Split split = split_of(of_lane);
      product[l] = split.mantissa;
      of[kCost][l] += kLogOf2 * (powers + split.exponent);
    }
  }

  SYNCHRONIZAR_INLINE void end(double annealing) {
    const double squared = annealing * annealing;
    for (int l = 0; l < kLanes; ++l) of[kCost][l] = squared * (of[kCost][l] + log_of_normal(product[l]));
  }

  Sums total() const {
    std::array<double, kBend + 1> sum{};
    for (size_t k = 0; k < sum.size(); ++k) {
      for (const double of_lane : of[k]) sum[k] += of_lane;
    }
    Sums out;
    size_t next = 0;
    for (size_t a = 0; a < kNumbers; ++a) {
      for (size_t b = a; b < kNumbers; ++b) out.squares[a][b] = sum[next++];
    }
    for (size_t a = 0; a < kNumbers; ++a) out.gradient[a] = sum[next++];
    out.cost = sum[kCost];
    out.bend = sum[kBend];
    return out;
  }
};

// `columns` are those of all ranges, `stride` apart.
template <class Loss, bool kCostOnly, bool kReweighted>
SYNCHRONIZAR_INLINE void add_block(const double* columns, Eigen::Index stride, const double* late,
                                   const Pair& pair, const Loss& loss, Lanes& sums) {
  const double* x_i = columns + kXi * stride;
  const double* y_i = columns + kYi * stride;
  const double* z_i = columns + kZi * stride;
  const double* x_j = columns + kXj * stride;
  const double* y_j = columns + kYj * stride;
  const double* z_j = columns + kZj * stride;
  const double* measured = columns + kMeasured * stride;
  const double* sigma = columns + kSigma * stride;
  const double* per_sigma = columns + kPerSigma * stride;
  const double* filled = columns + kFilled * stride;
  const Place i = pair.i, j = pair.j;
  const double between_x = i.x - j.x, between_y = i.y - j.y, between_z = i.z - j.z;
  const double per_annealing = 1.0 / pair.annealing;
  // NOLINTBEGIN(modernize-avoid-c-arrays): what loops without branches read and write. Several short loops
  // wait less than one long one, whose steps are long chains.
  double row[kNumbers][kBlock], whitened[kBlock], level[kBlock];
  double information[kBlock], slope[kBlock], cost[kBlock], ratio[kBlock], bend[kBlock];
  // NOLINTEND(modernize-avoid-c-arrays)
  for (int n = 0; n < kBlock; ++n) {
    const double arm_xi = i.cos_yaw * x_i[n] - i.sin_yaw * y_i[n];
    const double arm_yi = i.sin_yaw * x_i[n] + i.cos_yaw * y_i[n];
    const double arm_xj = j.cos_yaw * x_j[n] - j.sin_yaw * y_j[n];
    const double arm_yj = j.sin_yaw * x_j[n] + j.cos_yaw * y_j[n];
    const double dx = between_x + arm_xi - arm_xj, dy = between_y + arm_yi - arm_yj;
    const double dz = between_z + z_i[n] - z_j[n];
    const double distance = std::sqrt(dx * dx + dy * dy + dz * dz);
    whitened[n] = (distance - measured[n]) * per_sigma[n];
    if constexpr (!kCostOnly) {
      const double per_distance = distance > 0.0 ? 1.0 / distance : 0.0;
      const double ux = dx * per_distance, uy = dy * per_distance, uz = dz * per_distance;
      level[n] = (1.0 - uz * uz) * per_distance;
      row[0][n] = ux;
      row[1][n] = uy;
      row[2][n] = uz;
      row[3][n] = uy * arm_xi - ux * arm_yi;
      row[4][n] = ux * arm_yj - uy * arm_xj;
    }
  }
  for (int n = 0; n < kBlock; ++n) {
    const SplitLoss value = loss.split(whitened[n] * per_annealing, sigma[n], late[n]);
    cost[n] = value.plain;
    ratio[n] = filled[n] > 0.0 ? value.ratio : 1.0;
    if constexpr (!kCostOnly) {
      const double least = 0.1 * value.weight;
      const double curvature = value.curvature > least ? value.curvature : least;
      const double scaled = per_sigma[n] * filled[n];
      information[n] = (kReweighted ? value.weight : curvature) * per_sigma[n] * scaled;
      slope[n] = value.weight * whitened[n] * scaled;
      bend[n] = slope[n] * level[n];
    }
  }
  sums.add_dot(kCost, cost, filled);
  sums.add_logs(ratio);
  if constexpr (!kCostOnly) {
    int next = 0;
    for (int a = 0; a < kNumbers; ++a) {
      double weighted[kBlock];  // NOLINT(modernize-avoid-c-arrays): as above
      for (int n = 0; n < kBlock; ++n) weighted[n] = information[n] * row[a][n];
      for (int b = a; b < kNumbers; ++b) sums.add_dot(next++, weighted, row[b]);
    }
    for (const auto& of_number : row) sums.add_dot(next++, slope, of_number);
    sums.add_dot(kBend, bend, filled);
  }
}

struct Rows {
  const double* columns;
  Eigen::Index stride;
  const double* late;
  Eigen::Index size;
};

template <class Loss, bool kCostOnly, bool kReweighted>
SYNCHRONIZAR_INLINE Sums sums_of(const Rows& rows, const Pair& pair, const Loss& loss) {
  Lanes out;
  for (Eigen::Index n = 0; n < rows.size; n += kBlock)
    add_block<Loss, kCostOnly, kReweighted>(rows.columns + n, rows.stride, rows.late + n, pair, loss, out);
  out.end(pair.annealing);
  return out.total();
}

template <class Loss, bool kCostOnly, bool kReweighted>
SYNCHRONIZAR_AVX2 Sums sums_by_avx2(const Rows& rows, const Pair& pair, const Loss& loss) {
  return sums_of<Loss, kCostOnly, kReweighted>(rows, pair, loss);
}

template <class Loss, bool kCostOnly, bool kReweighted>
Sums sums(const Rows& rows, const Pair& pair, const Loss& loss) {
  return has_avx2() ? sums_by_avx2<Loss, kCostOnly, kReweighted>(rows, pair, loss)
                    : sums_of<Loss, kCostOnly, kReweighted>(rows, pair, loss);
}

Rows rows_of(const Columns& columns, Eigen::Index pair, const double* late) {
  const Eigen::Index begin = columns.begin(pair);
  return {columns.data() + begin, columns.rows(), late + begin, columns.end(pair) - begin};
}

}  // namespace

Place::Place(const UserPose& frame)
    : x(frame.frame_x),
      y(frame.frame_y),
      z(frame.frame_height),
      cos_yaw(std::cos(frame.frame_yaw)),
      sin_yaw(std::sin(frame.frame_yaw)) {}

Columns::Columns(const std::vector<Eigen::Index>& counts) : begin_{0} {
  for (const Eigen::Index count : counts)
    begin_.push_back(begin_.back() + (count + kBlock - 1) / kBlock * kBlock);
  values_.setZero(begin_.back(), kNamed);
  values_.middleCols(kSigma, 2).setOnes();
}

void Columns::fill(Eigen::Index pair, const Eigen::Ref<const Points>& i, const Eigen::Ref<const Points>& j,
                   const Eigen::Ref<const Column>& measured, const Eigen::Ref<const Column>& sigma) {
  for (Eigen::Index n = 0; n < measured.size(); ++n) {
    const Eigen::Index to = begin(pair) + n;
    for (int axis = 0; axis < 3; ++axis) {
      values_(to, kXi + axis) = i(n, axis);
      values_(to, kXj + axis) = j(n, axis);
    }
    values_(to, kMeasured) = measured[n];
    values_(to, kSigma) = sigma[n];
    values_(to, kPerSigma) = 1.0 / sigma[n];
    values_(to, kFilled) = 1.0;
  }
}

void Columns::fill_late(Eigen::Index pair, const Eigen::Ref<const Column>& sigma,
                        const Eigen::Ref<const Column>& nlos_odds, const NlosMixture& loss,
                        Eigen::ArrayXd& late) const {
  for (Eigen::Index n = 0; n < sigma.size(); ++n)
    late[begin(pair) + n] = loss.background(-1.0, {sigma[n], nlos_odds[n]});
}

Sums nlos_mixture(const Columns& columns, Eigen::Index pair, const Place& i, const Place& j,
                  const NlosMixture& loss, double annealing, const Eigen::ArrayXd& late) {
  return sums<BranchlessMixture, false, false>(rows_of(columns, pair, late.data()), {i, j, annealing},
                                               BranchlessMixture(loss));
}

double nlos_mixture_cost(const Columns& columns, Eigen::Index pair, const Place& i, const Place& j,
                         const NlosMixture& loss, double annealing, const Eigen::ArrayXd& late) {
  return sums<BranchlessMixture, true, false>(rows_of(columns, pair, late.data()), {i, j, annealing},
                                              BranchlessMixture(loss))
      .cost;
}

Sums reweighted(const Columns& columns, Eigen::Index pair, const Place& i, const Place& j,
                const NlosMixture& loss, const Eigen::ArrayXd& late) {
  return sums<BranchlessMixture, false, true>(rows_of(columns, pair, late.data()), {i, j, 1.0},
                                              BranchlessMixture(loss));
}

Sums reweighted(const Columns& columns, Eigen::Index pair, const Place& i, const Place& j,
                const GemanMcClure& loss) {
  // Its rows are read but not used.
  return sums<BranchlessGemanMcClure, false, true>(rows_of(columns, pair, columns.data()), {i, j, 1.0},
                                                   BranchlessGemanMcClure(loss));
}

}  // namespace synchronizar::pair_sums
