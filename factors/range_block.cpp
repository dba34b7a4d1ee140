#include "factors/range_block.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "factors/branchless_loss.h"
#include "factors/squeeze.h"

namespace synchronizar {

RangeBlock::RangeBlock(Points o_i, Points o_j, Column measured, Column sigma, Column nlos_odds)
    : o_i_(std::move(o_i)),
      o_j_(std::move(o_j)),
      measured_(std::move(measured)),
      sigma_(std::move(sigma)),
      nlos_odds_(std::move(nlos_odds)) {}

RangeBlock RangeBlock::with_nlos_odds(Column nlos_odds) const {
  RangeBlock out = *this;
  out.nlos_odds_ = std::move(nlos_odds);
  return out;
}

template <class Visit>
void RangeBlock::for_each_line(const UserPose& i, const UserPose& j, Visit visit) const {
  const CommonFromLocal common_from_i(i), common_from_j(j);
  for (Eigen::Index n = 0; n < size(); ++n) {
    visit(n, Line(common_from_i(o_i_.row(n)), common_from_j(o_j_.row(n))));
  }
}

Column RangeBlock::residuals(const UserPose& i, const UserPose& j) const {
  Column out(size());
  for_each_line(i, j, [&](Eigen::Index n, const Line& line) { out[n] = line.distance - measured_[n]; });
  return out;
}

double RangeBlock::cost(const UserPose& i, const UserPose& j, const Loss& loss) const {
  double sum = 0.0;
  std::visit(
      [&](const auto& kind) {
        for_each_line(i, j, [&](Eigen::Index n, const Line& line) {
          const double e = (line.distance - measured_[n]) / sigma_[n];
          sum += annealed(kind, loss.annealing, e, traits(n)).rho;
        });
      },
      loss.kind);
  return sum;
}

namespace {

// One range at each height difference from `first` (m) on in steps.
struct Heights {
  double level2, first, step, measured, sigma;
  Eigen::Index count;
};

// The sum of losses at each of them. Of those whose logarithm is not taken yet it is kept as the product of
// the mantissas and the sum of the exponents.
struct Profile {
  static constexpr int kMostHeld = 512;  // mantissas are about one: so many do not overflow

  Column sum;
  Eigen::ArrayXd product, exponent;
  int held = 0;

  explicit Profile(Eigen::Index size)
      : sum(Column::Zero(size)), product(Eigen::ArrayXd::Ones(size)), exponent(Eigen::ArrayXd::Zero(size)) {}

  void take_logarithms() {
    if (held == 0) return;
    sum.array() += kLogOf2 * exponent + product.log();
    product.setOnes();
    exponent.setZero();
    held = 0;
  }
};

struct ProfileRows {
  double *sum, *product, *exponent;
};

SYNCHRONIZAR_INLINE void add_profile(const Heights& heights, const BranchlessMixture& loss, double late,
                                     const ProfileRows& out) {
  const Heights at = heights;
  const double per_sigma = 1.0 / at.sigma;
  for (Eigen::Index s = 0; s < at.count; ++s) {
    const double z = at.first + static_cast<double>(static_cast<int>(s)) * at.step;
    const double e = (std::sqrt(at.level2 + z * z) - at.measured) * per_sigma;
    const SplitLoss value = loss.split(e, at.sigma, late);
    const Split ratio = split_of(value.ratio);
    out.sum[s] += value.plain;
    out.product[s] *= ratio.mantissa;
    out.exponent[s] += ratio.exponent;
  }
}

SYNCHRONIZAR_AVX2 void add_profile_by_avx2(const Heights& at, const BranchlessMixture& loss, double late,
                                           const ProfileRows& out) {
  add_profile(at, loss, late, out);
}

void add_profile(const Heights& at, const NlosMixture& loss, const RangeTraits& traits, Profile& profile) {
  const double late = loss.background(-1.0, traits);
  const BranchlessMixture branchless(loss);
  const ProfileRows out{profile.sum.data(), profile.product.data(), profile.exponent.data()};
  has_avx2() ? add_profile_by_avx2(at, branchless, late, out) : add_profile(at, branchless, late, out);
  if (++profile.held == Profile::kMostHeld) profile.take_logarithms();
}

template <class Kind>
void add_profile(const Heights& at, const Kind& kind, const RangeTraits& traits, Profile& profile) {
  for (Eigen::Index s = 0; s < at.count; ++s) {
    const double z = at.first + static_cast<double>(s) * at.step;
    profile.sum[s] += kind((std::sqrt(at.level2 + z * z) - at.measured) / at.sigma, traits).rho;
  }
}

}  // namespace

Column RangeBlock::height_profile(const UserPose& i, const UserPose& j, const LossKind& loss, double step,
                                  int zero, int most_ranges) const {
  const CommonFromLocal common_from_i(i), common_from_j(j);
  const double difference_now = i.frame_height - j.frame_height;
  const Eigen::Index n = std::min<Eigen::Index>(size(), most_ranges);
  Profile profile(2 * zero + 1);
  std::visit(
      [&](const auto& kind) {
        for (Eigen::Index k = 0; k < n; ++k) {
          const Eigen::Index row = (2 * k + 1) * size() / (2 * n);
          const Vector3 between = common_from_i(o_i_.row(row)) - common_from_j(o_j_.row(row));
          const Heights at{between.head<2>().squaredNorm(),
                           between.z() - difference_now - zero * step,
                           step,
                           measured_[row],
                           sigma_[row],
                           profile.sum.size()};
          add_profile(at, kind, traits(row), profile);
        }
      },
      loss);
  profile.take_logarithms();
  return profile.sum * (static_cast<double>(size()) / static_cast<double>(n));
}

RangeBlock::SquareRoot RangeBlock::square_root(const UserPose& i, const UserPose& j, const Loss& loss) const {
  Squeeze<kRows> rows;
  double height_information = 0.0;
  std::visit(
      [&](const auto& kind) {
        for_each_line(i, j, [&](Eigen::Index n, const Line& line) {
          const double e = (line.distance - measured_[n]) / sigma_[n];
          const LossValue value = annealed(kind, loss.annealing, e, traits(n));
          const double slope = value.weight * e;
          const double root = curvature_root(value);
          if (root == 0.0) return;
          auto row = rows.next();
          row.template head<4>() = root / sigma_[n] * line.coordinates().transpose();
          row[4] = slope / root;
          height_information += line.height_curvature(slope / sigma_[n]);
        });
      },
      loss.kind);
  if (height_information > 0.0) rows.next()[2] = std::sqrt(height_information);
  const auto triangle = rows.triangle();
  SquareRoot out;
  out.leftCols<kUserColumns>() = triangle.leftCols<4>() * line_to_user(i);
  out.middleCols<kUserColumns>(kUserColumns) = -triangle.leftCols<4>() * line_to_user(j);
  out.rightCols<1>() = triangle.col(4);
  return out;
}

double RangeBlock::height_curvature(const UserPose& i, const UserPose& j, const Loss& loss) const {
  double sum = 0.0;
  std::visit(
      [&](const auto& kind) {
        for_each_line(i, j, [&](Eigen::Index n, const Line& line) {
          const double e = (line.distance - measured_[n]) / sigma_[n];
          const double slope = annealed(kind, loss.annealing, e, traits(n)).weight * e;
          sum += line.height_curvature(slope / sigma_[n]);
        });
      },
      loss.kind);
  return sum;
}

Column RangeBlock::weights(const UserPose& i, const UserPose& j, const Loss& loss) const {
  Column out(size());
  std::visit(
      [&](const auto& kind) {
        for_each_line(i, j, [&](Eigen::Index n, const Line& line) {
          const double e = (line.distance - measured_[n]) / sigma_[n];
          out[n] = annealed(kind, loss.annealing, e, traits(n)).weight;
        });
      },
      loss.kind);
  return out;
}

Column RangeBlock::inlier_probability(const UserPose& i, const UserPose& j, const NlosMixture& nlos) const {
  Column out(size());
  for_each_line(i, j, [&](Eigen::Index n, const Line& line) {
    out[n] = nlos.inlier_probability((line.distance - measured_[n]) / sigma_[n], traits(n));
  });
  return out;
}

}  // namespace synchronizar
