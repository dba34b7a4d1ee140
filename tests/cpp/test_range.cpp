#include <complex>
#include <random>
#include <utility>

#include "factors/range.h"
#include "tests/cpp/check.h"

using namespace synchronizar;

namespace {

using Row = Eigen::Matrix<double, 1, 2 * kUserColumns>;
using Complex = std::complex<double>;
using Delta = Eigen::Matrix<Complex, 1, 2 * kUserColumns>;

// Where the antenna lies after gtsam's retraction F Exp(d_F), H + d_H, X Exp(d_X), Z + d_Z, for steps so
// small that Exp(v, w) is (v, w).
Eigen::Matrix<Complex, 3, 1> antenna(const UserPose& user, const Vector3& o, const Delta& d, int at) {
  const auto turned = [](Complex yaw, Complex x, Complex y) {
    return std::pair(std::cos(yaw) * x - std::sin(yaw) * y, std::sin(yaw) * x + std::cos(yaw) * y);
  };
  const auto place = [&](double x, double y, double yaw, int column, Complex px, Complex py) {
    const auto [vx, vy] = turned(yaw, d[at + column], d[at + column + 1]);
    const auto [rx, ry] = turned(yaw + d[at + column + 2], px, py);
    return std::pair(x + vx + rx, y + vy + ry);
  };
  const auto [ux, uy] = place(user.local_x, user.local_y, user.local_yaw, 4, o.x(), o.y());
  const auto [cx, cy] = place(user.frame_x, user.frame_y, user.frame_yaw, 0, ux, uy);
  return {cx, cy, user.frame_height + d[at + 3] + user.local_height + d[at + 7] + o.z()};
}

// The derivative by a complex step, exact to the last digit: nothing is subtracted.
Row numerical_row(const UserPose& i, const Vector3& o_i, const UserPose& j, const Vector3& o_j) {
  constexpr double kStep = 1e-30;
  Row row;
  for (int column = 0; column < row.size(); ++column) {
    Delta d = Delta::Zero();
    d[column] = Complex(0.0, kStep);
    const auto between = (antenna(i, o_i, d, 0) - antenna(j, o_j, d, kUserColumns)).eval();
    const Complex squared = between.x() * between.x() + between.y() * between.y() + between.z() * between.z();
    row[column] = std::sqrt(squared).imag() / kStep;
  }
  return row;
}

struct Random {
  std::mt19937 engine{1};
  std::uniform_real_distribution<double> uniform{-10.0, 10.0};
  double operator()() { return uniform(engine); }
  Vector3 vector() { return Vector3((*this)(), (*this)(), (*this)()); }
  UserPose pose() {
    Random& u = *this;
    return UserPose{u(), u(), u(), u(), u(), u(), u(), u()};
  }
};

void a_residual_is_predicted_minus_measured() {
  // (1, 2) turned by a quarter is (-2, 1): the antennas are at (8, 21, 5.5) and (8, 24, 1.5).
  const UserPose i{10.0, 20.0, std::acos(0.0), 5.0}, j{8.0, 24.0, 0.0, 1.0};
  CHECK_NEAR(range_residual(i, {1.0, 2.0, 0.5}, j, {0.0, 0.0, 0.5}, 4.7), 0.3, 1e-12);
}

void a_keyframe_lies_in_its_users_frame() {
  const double quarter = std::acos(0.0);
  const UserPose i{10.0, 0.0, quarter, 1.0, 2.0, 0.0, quarter, 0.25};
  const Vector3 q = CommonFromLocal(i)({1.0, 0.0, 0.75});
  CHECK_NEAR((q - Vector3(9.0, 2.0, 2.0)).norm(), 0.0, 1e-12);
}

void every_column_is_the_derivative_under_gtsams_retraction() {
  Random random;
  for (int n = 0; n < 1000; ++n) {
    const UserPose i = random.pose(), j = random.pose();
    const Vector3 o_i = random.vector(), o_j = random.vector();
    Row row;
    range_residual(i, o_i, j, o_j, 0.0, &row);
    CHECK_NEAR((row - numerical_row(i, o_i, j, o_j)).cwiseAbs().maxCoeff(), 0.0, 1e-9);
  }
}

void who_is_called_i_does_not_matter() {
  Random random;
  for (int n = 0; n < 100; ++n) {
    const UserPose i = random.pose(), j = random.pose();
    const Vector3 o_i = random.vector(), o_j = random.vector();
    Row row, swapped;
    const double residual = range_residual(i, o_i, j, o_j, 1.0, &row);
    CHECK_NEAR(range_residual(j, o_j, i, o_i, 1.0, &swapped), residual, 1e-12);
    CHECK_NEAR((row.head<kUserColumns>() - swapped.tail<kUserColumns>()).norm(), 0.0, 1e-9);
    CHECK_NEAR((row.tail<kUserColumns>() - swapped.head<kUserColumns>()).norm(), 0.0, 1e-9);
  }
}

void a_lines_moment_is_that_of_either_antenna() {
  Random random;
  for (int n = 0; n < 100; ++n) {
    const Vector3 q_i = random.vector(), q_j = random.vector();
    const Line line(q_i, q_j);
    const auto moment = [&](const Vector3& q) {
      return line.direction.y() * q.x() - line.direction.x() * q.y();
    };
    CHECK_NEAR(line.moment, moment(q_i), 1e-12);
    CHECK_NEAR(line.moment, moment(q_j), 1e-12);
    CHECK_NEAR(line.direction.norm(), 1.0, 1e-12);
    CHECK_NEAR(line.distance, (q_i - q_j).norm(), 1e-12);
  }
}

void antennas_that_coincide_have_no_row() {
  const UserPose i{1.0, 2.0, 0.0, 0.5}, j{2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5};
  const Vector3 o(1.0, 0.0, 0.0), origin(0.0, 0.0, 0.0);
  Row row;
  CHECK_NEAR(range_residual(i, o, j, origin, 0.3, &row), -0.3, 0.0);
  CHECK_NEAR(row.cwiseAbs().maxCoeff(), 0.0, 0.0);
  CHECK_NEAR(range_residual(j, origin, i, o, 0.3, &row), -0.3, 0.0);
  CHECK_NEAR(row.cwiseAbs().maxCoeff(), 0.0, 0.0);
}

void a_row_stays_true_for_antennas_all_but_touching_and_far_away() {
  const Vector3 direction = Vector3(2.0, -1.0, 2.0) / 3.0, origin(0.0, 0.0, 0.0);
  for (const double distance : {1e-150, 1e-9, 1e3, 1e6}) {
    const UserPose i{0.0, 0.0, 0.3};
    const UserPose j{distance * direction.x(), distance * direction.y(), 1.1, distance * direction.z()};
    Row row;
    CHECK_NEAR(range_residual(i, origin, j, origin, 0.0, &row) / distance, 1.0, 1e-12);
    const double c = std::cos(0.3), s = std::sin(0.3);
    CHECK_NEAR(row[0], -(c * direction.x() + s * direction.y()), 1e-12);
    CHECK_NEAR(row[1], -(c * direction.y() - s * direction.x()), 1e-12);
    CHECK_NEAR(row[2], 0.0, 1e-12);
    CHECK_NEAR(row[3], -direction.z(), 1e-12);
  }
}

}  // namespace

int main() {
  a_residual_is_predicted_minus_measured();
  a_keyframe_lies_in_its_users_frame();
  every_column_is_the_derivative_under_gtsams_retraction();
  who_is_called_i_does_not_matter();
  a_lines_moment_is_that_of_either_antenna();
  antennas_that_coincide_have_no_row();
  a_row_stays_true_for_antennas_all_but_touching_and_far_away();
  return check::verdict();
}
