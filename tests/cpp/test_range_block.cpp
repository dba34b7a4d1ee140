#include <algorithm>
#include <random>

#include "factors/range_block.h"
#include "tests/cpp/check.h"

using namespace synchronizar;

namespace {

constexpr int kColumns = 2 * kUserColumns;
using Row = Eigen::Matrix<double, 1, kColumns>;
using Square = Eigen::Matrix<double, kColumns, kColumns>;

const UserPose kI{1.0, -2.0, 0.4, 0.3, 0.5, 1.5, -1.2, 0.1};
const UserPose kJ{4.0, 3.0, -2.5, -0.2, -1.0, 0.25, 0.8, 0.05};
const LossKind kLosses[] = {Squared{}, Huber{}, Cauchy{}, GemanMcClure{}, NlosMixture{1.0, 0.002}};

struct Ranges {
  Points o_i, o_j;
  Column measured, sigma, nlos_odds;

  RangeBlock block() const { return RangeBlock(o_i, o_j, measured, sigma, nlos_odds); }
};

// n ranges with noise of 0.1 m, every fourth late by 1 m, all of them too long by `offset` (m).
Ranges make_ranges(int n, double offset) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  Ranges out{Points(n, 3), Points(n, 3), Column(n), Column(n), Column(n)};
  for (int k = 0; k < n; ++k) {
    for (int axis = 0; axis < 3; ++axis) {
      out.o_i(k, axis) = 4.0 * normal(random);
      out.o_j(k, axis) = 4.0 * normal(random);
    }
    const double exact = range_residual(kI, out.o_i.row(k), kJ, out.o_j.row(k), 0.0);
    out.measured[k] = exact + 0.1 * normal(random) + (k % 4 == 0 ? 1.0 : 0.0) + offset;
    out.sigma[k] = 0.1;
    out.nlos_odds[k] = 0.25;
  }
  return out;
}

LossValue value_of(const Loss& loss, double e, const RangeTraits& range) {
  return std::visit([&](const auto& kind) { return annealed(kind, loss.annealing, e, range); }, loss.kind);
}

// What a block is the sum of, one range at a time.
struct Sum {
  double cost = 0.0, height_curvature = 0.0;
  Eigen::Matrix<double, kColumns, 1> gradient = Eigen::Matrix<double, kColumns, 1>::Zero();
  Square information = Square::Zero();

  Sum(const Ranges& ranges, const Loss& loss) {
    for (Eigen::Index k = 0; k < ranges.measured.size(); ++k) {
      const Vector3 o_i = ranges.o_i.row(k), o_j = ranges.o_j.row(k);
      const double sigma = ranges.sigma[k];
      Row row;
      const double e = range_residual(kI, o_i, kJ, o_j, ranges.measured[k], &row) / sigma;
      const LossValue value = value_of(loss, e, {sigma, ranges.nlos_odds[k]});
      row /= sigma;
      cost += value.rho;
      gradient += value.weight * e * row.transpose();
      information += std::max(value.curvature, 0.1 * value.weight) * row.transpose() * row;
      const Vector3 between = CommonFromLocal(kI)(o_i) - CommonFromLocal(kJ)(o_j);
      const double level = between.head<2>().squaredNorm() / between.squaredNorm();
      height_curvature += value.weight * e / sigma * level / between.norm();
    }
    Row up = Row::Zero();
    up[3] = up[7] = 1.0;
    up[11] = up[15] = -1.0;
    if (height_curvature > 0.0) information += height_curvature * up.transpose() * up;
  }
};

void a_block_is_the_sum_of_its_ranges() {
  for (const int n : {1, 2, 5, 60, 511, 512, 513, 512 * 3 + 1}) {
    for (const double offset : {0.5, -0.5}) {
      const Ranges ranges = make_ranges(n, offset);
      for (const LossKind& kind : kLosses) {
        for (const double annealing : {1.0, 3.0}) {
          const Loss loss{kind, annealing};
          const Sum sum(ranges, loss);
          const double scale = sum.information.cwiseAbs().maxCoeff();
          CHECK_NEAR(ranges.block().cost(kI, kJ, loss), sum.cost, 1e-12 * sum.cost);
          const RangeBlock::SquareRoot root = ranges.block().square_root(kI, kJ, loss);
          const auto A = root.leftCols<kColumns>();
          const auto b = root.rightCols<1>();
          CHECK_NEAR((A.transpose() * A - sum.information).cwiseAbs().maxCoeff(), 0.0, 1e-12 * scale);
          CHECK_NEAR((A.transpose() * b - sum.gradient).cwiseAbs().maxCoeff(), 0.0, 1e-12 * scale);
        }
      }
    }
  }
}

void heights_are_bent_where_ranges_are_predicted_too_long_alone() {
  CHECK(Sum(make_ranges(60, -0.5), {Squared{}}).height_curvature > 0.0);
  CHECK(Sum(make_ranges(60, 0.5), {Squared{}}).height_curvature < 0.0);
}

void weights_and_probabilities_are_those_of_the_losses() {
  const Ranges ranges = make_ranges(20, 0.0);
  const Column residuals = ranges.block().residuals(kI, kJ);
  const NlosMixture nlos{1.0, 0.002};
  const Column weights = ranges.block().weights(kI, kJ, {nlos, 2.0});
  const Column inlier = ranges.block().inlier_probability(kI, kJ, nlos);
  for (int k = 0; k < 20; ++k) {
    const double expected = range_residual(kI, ranges.o_i.row(k), kJ, ranges.o_j.row(k), ranges.measured[k]);
    CHECK_NEAR(residuals[k], expected, 0.0);
    const RangeTraits traits{ranges.sigma[k], ranges.nlos_odds[k]};
    CHECK_NEAR(weights[k], nlos(expected / 0.1 / 2.0, traits).weight, 1e-15);
    CHECK_NEAR(inlier[k], nlos.inlier_probability(expected / 0.1, traits), 1e-15);
  }
}

void other_odds_leave_the_block_as_it_was() {
  const Ranges ranges = make_ranges(20, 0.0);
  const RangeBlock block = ranges.block();
  const Loss loss{NlosMixture{1.0, 0.002}};
  const double before = block.cost(kI, kJ, loss);
  Ranges others = ranges;
  others.nlos_odds = Column::LinSpaced(20, 0.1, 3.0);
  CHECK_NEAR(block.with_nlos_odds(others.nlos_odds).cost(kI, kJ, loss), others.block().cost(kI, kJ, loss),
             0.0);
  CHECK_NEAR(block.cost(kI, kJ, loss), before, 0.0);
  CHECK(block.with_nlos_odds(others.nlos_odds).size() == 20);
}

void ranges_without_information_give_zeros() {
  Ranges ranges = make_ranges(10, 0.0);
  ranges.measured.setConstant(1e100);  // the weight is zero, to the last bit
  const RangeBlock::SquareRoot root = ranges.block().square_root(kI, kJ, {GemanMcClure{}});
  CHECK_NEAR(root.cwiseAbs().maxCoeff(), 0.0, 0.0);
}

}  // namespace

int main() {
  a_block_is_the_sum_of_its_ranges();
  heights_are_bent_where_ranges_are_predicted_too_long_alone();
  weights_and_probabilities_are_those_of_the_losses();
  other_odds_leave_the_block_as_it_was();
  ranges_without_information_give_zeros();
  return check::verdict();
}
