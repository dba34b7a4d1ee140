// Functions without branches beside those of the standard library and of loss.h.
#include "factors/branchless_loss.h"
#include "factors/pair_sums.h"
#include "tests/cpp/check.h"

using namespace synchronizar;

namespace {

void an_exponential_and_a_logarithm_have_almost_all_digits() {
  for (double x = 0.0; x > -699.0; x = 1.37 * x - 1e-3) {
    CHECK_NEAR(exp_of_negative(x) / std::exp(x), 1.0, 1e-14);
    CHECK_NEAR(log_of_normal(std::exp(x)), std::log(std::exp(x)), 1e-14 * (1.0 - x));
    CHECK_NEAR(log_of_normal(std::exp(-x)), std::log(std::exp(-x)), 1e-14 * (1.0 - x));
    if (x > -85.0) CHECK_NEAR(exp_of_negative(static_cast<float>(x)) / std::exp(x), 1.0, 1e-5);
  }
}

void a_loss_without_branches_is_the_loss() {
  const NlosMixture loss{1.5, 0.01};
  for (const double odds : {0.0, 1e-12, 0.05, 30.0}) {
    for (double e = -40.0; e < 40.0; e += 0.37) {
      const RangeTraits range{0.1, odds};
      const LossValue expected = loss(e, range);
      const LossValue told = BranchlessMixture(loss)(e, range.sigma, loss.background(-1.0, range));
      CHECK_NEAR(told.rho, expected.rho, 1e-12 * (1.0 + expected.rho));
      CHECK_NEAR(told.weight, expected.weight, 1e-12);
      CHECK_NEAR(told.curvature, expected.curvature, 1e-10);
    }
  }
}

// Of 45 ranges, more than a block and no multiple of one.
void the_sums_of_a_pair_are_those_of_single_ranges() {
  const NlosMixture loss{1.5, 0.01};
  const int n = 45;
  Points i(n, 3), j(n, 3);
  Column measured(n), sigma(n), odds(n);
  for (int k = 0; k < n; ++k) {
    i.row(k) << std::sin(0.7 * k), std::cos(0.9 * k), 0.1 * std::sin(k);
    j.row(k) << std::cos(0.4 * k), std::sin(1.1 * k), 0.2 * std::cos(k);
    measured[k] = 3.0 + std::sin(0.3 * k);
    sigma[k] = 0.1 + 0.01 * (k % 7);
    odds[k] = 0.01 * (k % 5);
  }
  pair_sums::Columns columns({n});
  columns.fill(0, i, j, measured, sigma);
  Eigen::ArrayXd late = Eigen::ArrayXd::Zero(columns.rows());
  columns.fill_late(0, sigma, odds, loss, late);
  const UserPose of_i{0.3, -0.2, 0.4, 0.1}, of_j{2.5, 1.9, -1.2, -0.3};
  const pair_sums::Place at_i(of_i), at_j(of_j);
  const pair_sums::Sums told = pair_sums::nlos_mixture(columns, 0, at_i, at_j, loss, 2.0, late);
  const double cost = pair_sums::nlos_mixture_cost(columns, 0, at_i, at_j, loss, 2.0, late);
  Eigen::Matrix<double, 5, 5> squares = Eigen::Matrix<double, 5, 5>::Zero();
  Eigen::Matrix<double, 5, 1> gradient = Eigen::Matrix<double, 5, 1>::Zero();
  double expected = 0.0, bend = 0.0;
  for (int k = 0; k < n; ++k) {
    const CommonFromLocal from_i(of_i), from_j(of_j);
    const Vector3 q_i = from_i(i.row(k)), q_j = from_j(j.row(k));
    const Line line(q_i, q_j);
    const Vector3 arm_i = q_i - from_i.origin, arm_j = q_j - from_j.origin, &d = line.direction;
    Eigen::Matrix<double, 5, 1> row;
    row << d, d.y() * arm_i.x() - d.x() * arm_i.y(), d.x() * arm_j.y() - d.y() * arm_j.x();
    const double e = (line.distance - measured[k]) / sigma[k];
    const LossValue value = annealed(loss, 2.0, e, {sigma[k], odds[k]});
    const double root = curvature_root(value) / sigma[k], slope = value.weight * e / sigma[k];
    squares += root * root * row * row.transpose();
    gradient += slope * row;
    expected += value.rho;
    bend += line.height_curvature(slope);
  }
  for (size_t a = 0; a < 5; ++a) {
    const auto row = static_cast<Eigen::Index>(a);
    for (size_t b = a; b < 5; ++b)
      CHECK_NEAR(told.squares[a][b], squares(row, static_cast<Eigen::Index>(b)), 1e-9);
    CHECK_NEAR(told.gradient[a], gradient[row], 1e-9);
  }
  CHECK_NEAR(told.cost, expected, 1e-9);
  CHECK_NEAR(cost, expected, 1e-9);
  CHECK_NEAR(told.bend, bend, 1e-9);
}

}  // namespace

int main() {
  an_exponential_and_a_logarithm_have_almost_all_digits();
  a_loss_without_branches_is_the_loss();
  the_sums_of_a_pair_are_those_of_single_ranges();
  return check::verdict();
}
