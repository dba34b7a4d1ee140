#include <algorithm>
#include <complex>
#include <random>
#include <utility>

#include "factors/calibrated_range_block.h"
#include "tests/cpp/check.h"

using namespace synchronizar;

namespace {

constexpr int kColumns = 2 * kUserAndCalibrationColumns;
using Row = Eigen::Matrix<double, 1, kColumns>;
using Square = Eigen::Matrix<double, kColumns, kColumns>;
using Complex = std::complex<double>;
using Delta = Eigen::Matrix<Complex, 1, kColumns>;

const LossKind kLosses[] = {Squared{}, Huber{}, Cauchy{}, GemanMcClure{}, NlosMixture{1.0, 0.002}};

// A user and its device.
struct End {
  UserPose pose;
  Calibration device;
};

const End kI{{1.0, -2.0, 0.4, 0.3, 0.5, 1.5, -1.2, 0.1}, {0.2, 0.12, -0.15}};
const End kJ{{4.0, 3.0, -2.5, -0.2, -1.0, 0.25, 0.8, 0.05}, {-0.3, -0.05, 0.2}};

// Where the antenna lies after gtsam's retraction of the pose and sums on the device, for small steps.
Eigen::Matrix<Complex, 3, 1> antenna(const End& end, const Antenna& a, const Delta& d, int at) {
  const UserPose& user = end.pose;
  const Complex scale = std::exp(end.device.log_scale + d[at + 8]);
  const Complex clock = end.device.clock_offset + d[at + 10];
  const auto beside = [&](int axis) {
    return scale * a.offset[axis] + a.lever[axis] + clock * a.velocity[axis];
  };
  const auto turned = [](Complex yaw, Complex x, Complex y) {
    return std::pair(std::cos(yaw) * x - std::sin(yaw) * y, std::sin(yaw) * x + std::cos(yaw) * y);
  };
  const auto [vx, vy] = turned(user.local_yaw, d[at + 4], d[at + 5]);
  const auto [bx, by] = turned(user.local_yaw + d[at + 6], beside(0), beside(1));
  const Complex mx = scale * (user.local_x + vx) + bx, my = scale * (user.local_y + vy) + by;
  const auto [wx, wy] = turned(user.frame_yaw, d[at], d[at + 1]);
  const auto [qx, qy] = turned(user.frame_yaw + d[at + 2], mx, my);
  const Complex height = user.frame_height + d[at + 3] + scale * (user.local_height + d[at + 7]) + beside(2);
  return {user.frame_x + wx + qx, user.frame_y + wy + qy, height};
}

// What is predicted of a range.
Complex predicted(const End& i, const Antenna& a_i, const End& j, const Antenna& a_j, const Delta& d) {
  const auto between = (antenna(i, a_i, d, 0) - antenna(j, a_j, d, kUserAndCalibrationColumns)).eval();
  const Complex squared = between.x() * between.x() + between.y() * between.y() + between.z() * between.z();
  const Complex bias = i.device.range_bias + d[9] + j.device.range_bias + d[kUserAndCalibrationColumns + 9];
  return std::sqrt(squared) + bias;
}

// The derivative by a complex step, exact to the last digit: nothing is subtracted.
Row numerical_row(const End& i, const Antenna& a_i, const End& j, const Antenna& a_j) {
  constexpr double kStep = 1e-30;
  Row row;
  for (int column = 0; column < row.size(); ++column) {
    Delta d = Delta::Zero();
    d[column] = Complex(0.0, kStep);
    row[column] = predicted(i, a_i, j, a_j, d).imag() / kStep;
  }
  return row;
}

struct Random {
  std::mt19937 engine{1};
  double operator()(double most) { return std::uniform_real_distribution<double>(-most, most)(engine); }
  double normal() { return std::normal_distribution<double>()(engine); }
  Vector3 vector(double most) { return Vector3((*this)(most), (*this)(most), (*this)(most)); }
  End end() {
    Random& u = *this;
    return {{u(10), u(10), u(10), u(10), u(10), u(10), u(10), u(10)}, {u(0.7), u(0.5), u(0.5)}};
  }
  Antenna antenna() { return {vector(5.0), vector(0.3), vector(3.0)}; }
};

struct Ranges {
  Antennas i, j;
  Column measured, sigma, nlos_odds, range_weight;

  explicit Ranges(int n)
      : i{Points(n, 3), Points(n, 3), Points(n, 3)},
        j{Points(n, 3), Points(n, 3), Points(n, 3)},
        measured(n),
        sigma(n),
        nlos_odds(n),
        range_weight(n) {}

  Eigen::Index size() const { return measured.size(); }
  CalibratedRangeBlock block() const {
    return CalibratedRangeBlock(i, j, measured, sigma, nlos_odds, range_weight);
  }

  void set(Eigen::Index n, const Antenna& a_i, const Antenna& a_j) {
    i.offset.row(n) = a_i.offset, i.lever.row(n) = a_i.lever, i.velocity.row(n) = a_i.velocity;
    j.offset.row(n) = a_j.offset, j.lever.row(n) = a_j.lever, j.velocity.row(n) = a_j.velocity;
  }
};

// n ranges with noise of 0.1 m, every fourth late by 1 m, all of them too long by `offset` (m).
Ranges make_ranges(int n, double offset) {
  Random random;
  Ranges out(n);
  for (int k = 0; k < n; ++k) {
    const Antenna a_i = random.antenna(), a_j = random.antenna();
    out.set(k, a_i, a_j);
    const double exact = predicted(kI, a_i, kJ, a_j, Delta::Zero()).real();
    out.measured[k] = exact + 0.1 * random.normal() + (k % 4 == 0 ? 1.0 : 0.0) + offset;
    out.sigma[k] = 0.1 + 0.05 * (k % 3);
    out.nlos_odds[k] = 0.25;
    out.range_weight[k] = 0.2 + 0.3 * (k % 5);
  }
  return out;
}

CalibratedRangeBlock::SquareRoot square_root(const Ranges& ranges, const Loss& loss) {
  return ranges.block().square_root(kI.pose, kI.device, kJ.pose, kJ.device, loss);
}

double cost(const Ranges& ranges, const Loss& loss) {
  return ranges.block().cost(kI.pose, kI.device, kJ.pose, kJ.device, loss);
}

// What a block is the sum of, one range at a time.
struct Sum {
  double cost = 0.0, height_curvature = 0.0;
  Eigen::Matrix<double, kColumns, 1> gradient = Eigen::Matrix<double, kColumns, 1>::Zero();
  Square information = Square::Zero();

  Sum(const Ranges& ranges, const Loss& loss) {
    for (Eigen::Index k = 0; k < ranges.size(); ++k) {
      const Antenna a_i = ranges.i.at(k), a_j = ranges.j.at(k);
      const double sigma = ranges.sigma[k], range_weight = ranges.range_weight[k];
      const double e = (predicted(kI, a_i, kJ, a_j, Delta::Zero()).real() - ranges.measured[k]) / sigma;
      const RangeTraits traits{sigma, ranges.nlos_odds[k]};
      const LossValue value =
          std::visit([&](const auto& kind) { return annealed(kind, loss.annealing, e, traits); }, loss.kind);
      const Row row = numerical_row(kI, a_i, kJ, a_j) / sigma;
      cost += range_weight * value.rho;
      gradient += range_weight * value.weight * e * row.transpose();
      information += range_weight * std::max(value.curvature, 0.1 * value.weight) * row.transpose() * row;
      const Vector3 between =
          (antenna(kI, a_i, Delta::Zero(), 0) - antenna(kJ, a_j, Delta::Zero(), 0)).real();
      const double level = between.head<2>().squaredNorm() / between.squaredNorm();
      height_curvature += range_weight * value.weight * e / sigma * level / between.norm();
    }
    // A height of a keyframe is in SLAM's lengths.
    Row up = Row::Zero();
    up[3] = 1.0, up[7] = std::exp(kI.device.log_scale);
    up[kUserAndCalibrationColumns + 3] = -1.0,
                                    up[kUserAndCalibrationColumns + 7] = -std::exp(kJ.device.log_scale);
    if (height_curvature > 0.0) information += height_curvature * up.transpose() * up;
  }
};

void a_residual_is_predicted_minus_measured() {
  // In SLAM's lengths, half as long as they ought to be: the keyframe is at (1, 0, 0.5), the antenna (1, 0,
  // 0.25) from there and its lever (0, 1, 0.1) m. Half a second late it is (1, 0, 0.2) m further: (3, 1, 0.8)
  // m from the keyframe, or (-1, 3, 0.8) in the user's axes, and at (1, 3, 1.8) m. Turned by a quarter: (7,
  // 21, 6.8).
  const double quarter = std::acos(0.0);
  const UserPose pose_i{10.0, 20.0, quarter, 5.0, 1.0, 0.0, quarter, 0.5}, pose_j{7.0, 24.0, 0.3, 2.8};
  const Calibration calibration_i{std::log(2.0), 0.3, 0.5}, calibration_j{0.7, -0.1, -0.4};
  Ranges one(1);
  one.set(0, {{1.0, 0.0, 0.25}, {0.0, 1.0, 0.1}, {2.0, 0.0, 0.4}},
          {Vector3::Zero(), Vector3::Zero(), Vector3::Zero()});
  one.measured[0] = 4.7;
  one.sigma[0] = 0.1;
  one.nlos_odds[0] = 0.0;
  one.range_weight[0] = 0.5;
  // 5 m apart, and the radios add 0.2 m.
  CHECK_NEAR(one.block().residuals(pose_i, calibration_i, pose_j, calibration_j)[0], 0.5, 1e-12);
  CHECK_NEAR(one.block().cost(pose_i, calibration_i, pose_j, calibration_j, {Squared{}}), 0.5 * 0.5 * 25.0,
             1e-10);
}

void every_column_is_the_derivative_under_gtsams_retraction() {
  Random random;
  for (int n = 0; n < 1000; ++n) {
    const End i = random.end(), j = random.end();
    const Antenna a_i = random.antenna(), a_j = random.antenna();
    Ranges one(1);
    one.set(0, a_i, a_j);
    // Measured too long by one sigma, no height is bent, and the gradient of the cost is minus the row.
    one.measured[0] = predicted(i, a_i, j, a_j, Delta::Zero()).real() + 1.0;
    one.sigma[0] = one.range_weight[0] = 1.0;
    one.nlos_odds[0] = 0.0;
    const auto root = one.block().square_root(i.pose, i.device, j.pose, j.device, {Squared{}});
    const Row expected = numerical_row(i, a_i, j, a_j);
    const Row row = -root.rightCols<1>().transpose() * root.leftCols<kColumns>();
    CHECK_NEAR((row - expected).cwiseAbs().maxCoeff(), 0.0, 1e-11 * (1.0 + expected.cwiseAbs().maxCoeff()));
  }
}

void a_block_is_the_sum_of_its_ranges() {
  for (const int n : {1, 2, 10, 60, 502, 511, 512, 513, 512 * 3 + 1}) {
    for (const double offset : {0.5, -0.5}) {
      const Ranges ranges = make_ranges(n, offset);
      for (const LossKind& kind : kLosses) {
        for (const double annealing : {1.0, 3.0}) {
          const Loss loss{kind, annealing};
          const Sum sum(ranges, loss);
          const double scale = sum.information.cwiseAbs().maxCoeff();
          CHECK_NEAR(cost(ranges, loss), sum.cost, 1e-11 * sum.cost);
          const CalibratedRangeBlock::SquareRoot root = square_root(ranges, loss);
          const auto A = root.leftCols<kColumns>();
          const auto b = root.rightCols<1>();
          CHECK_NEAR((A.transpose() * A - sum.information).cwiseAbs().maxCoeff(), 0.0, 1e-11 * scale);
          CHECK_NEAR((A.transpose() * b - sum.gradient).cwiseAbs().maxCoeff(), 0.0, 1e-11 * scale);
        }
      }
    }
  }
}

void heights_are_bent_where_ranges_are_predicted_too_long_alone() {
  CHECK(Sum(make_ranges(60, -0.5), {Squared{}}).height_curvature > 0.0);
  CHECK(Sum(make_ranges(60, 0.5), {Squared{}}).height_curvature < 0.0);
}

void a_perfect_device_is_none() {
  Ranges ranges = make_ranges(60, 0.1);
  ranges.i.offset.setZero();
  ranges.j.offset.setZero();
  ranges.range_weight.setOnes();
  const RangeBlock plain(ranges.i.lever, ranges.j.lever, ranges.measured, ranges.sigma, ranges.nlos_odds);
  const Calibration perfect;
  const Column residuals = ranges.block().residuals(kI.pose, perfect, kJ.pose, perfect);
  CHECK_NEAR((residuals - plain.residuals(kI.pose, kJ.pose)).cwiseAbs().maxCoeff(), 0.0, 1e-13);
  for (const LossKind& kind : kLosses) {
    const Loss loss{kind, 2.0};
    const double expected = plain.cost(kI.pose, kJ.pose, loss);
    CHECK_NEAR(ranges.block().cost(kI.pose, perfect, kJ.pose, perfect, loss), expected, 1e-12 * expected);
    const auto device = ranges.block().square_root(kI.pose, perfect, kJ.pose, perfect, loss);
    const auto rigid = plain.square_root(kI.pose, kJ.pose, loss);
    Eigen::Matrix<double, CalibratedRangeBlock::kRows, 2 * kUserColumns + 1> kept;
    kept << device.leftCols<kUserColumns>(), device.middleCols<kUserColumns>(kUserAndCalibrationColumns),
        device.rightCols<1>();
    const auto found = (kept.transpose() * kept).eval();
    const auto wanted = (rigid.transpose() * rigid).eval();
    CHECK_NEAR((found - wanted).topRows<2 * kUserColumns>().cwiseAbs().maxCoeff(), 0.0,
               1e-12 * wanted.cwiseAbs().maxCoeff());
  }
}

void a_range_that_is_worth_two_is_two() {
  for (const double offset : {0.5, -0.5}) {
    Ranges once = make_ranges(40, offset), twice(80);
    once.range_weight.setConstant(2.0);
    for (Eigen::Index k = 0; k < 80; ++k) {
      twice.set(k, once.i.at(k / 2), once.j.at(k / 2));
      twice.measured[k] = once.measured[k / 2];
      twice.sigma[k] = once.sigma[k / 2];
      twice.nlos_odds[k] = once.nlos_odds[k / 2];
      twice.range_weight[k] = 1.0;
    }
    for (const LossKind& kind : kLosses) {
      CHECK_NEAR(cost(once, {kind}), cost(twice, {kind}), 1e-12 * cost(twice, {kind}));
      const auto a = square_root(once, {kind}), b = square_root(twice, {kind});
      const auto expected = (b.transpose() * b).eval();
      CHECK_NEAR((a.transpose() * a - expected).cwiseAbs().maxCoeff(), 0.0,
                 1e-12 * expected.cwiseAbs().maxCoeff());
    }
  }
}

void antennas_that_coincide_tell_of_the_radios_alone() {
  Ranges one(1);
  const Antenna origin{Vector3::Zero(), Vector3::Zero(), Vector3(1.0, 0.0, 0.0)};
  one.set(0, origin, origin);
  one.measured[0] = 0.3;
  one.sigma[0] = one.range_weight[0] = 1.0;
  one.nlos_odds[0] = 0.25;
  const UserPose pose;
  const Calibration i{0.0, 0.1, 0.0}, j;
  CHECK_NEAR(one.block().residuals(pose, i, pose, j)[0], -0.2, 1e-15);
  const auto root = one.block().square_root(pose, i, pose, j, {Squared{}});
  Row expected = Row::Zero();
  expected[9] = expected[kUserAndCalibrationColumns + 9] = -0.2;
  const Row gradient = root.rightCols<1>().transpose() * root.leftCols<kColumns>();
  CHECK_NEAR((gradient - expected).cwiseAbs().maxCoeff(), 0.0, 1e-15);
}

void ranges_without_information_give_zeros() {
  Ranges ranges = make_ranges(10, 0.0);
  ranges.measured.setConstant(1e100);  // the weight is zero, to the last bit
  CHECK_NEAR(square_root(ranges, {GemanMcClure{}}).cwiseAbs().maxCoeff(), 0.0, 0.0);
}

}  // namespace

int main() {
  a_residual_is_predicted_minus_measured();
  every_column_is_the_derivative_under_gtsams_retraction();
  a_block_is_the_sum_of_its_ranges();
  heights_are_bent_where_ranges_are_predicted_too_long_alone();
  a_perfect_device_is_none();
  a_range_that_is_worth_two_is_two();
  antennas_that_coincide_tell_of_the_radios_alone();
  ranges_without_information_give_zeros();
  return check::verdict();
}
