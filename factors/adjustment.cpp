#include "factors/adjustment.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <vector>

namespace synchronizar {
namespace {

constexpr double kNearest = 1e-3;  // m: nearer antennas have no direction
constexpr int kYaw = 3, kBias = 4, kScale = 5;

struct Mover {
  double cos_yaw, sin_yaw, bias;
  Vector3 centre, moved;

  Vector3 arm(const Vector3& p) const {
    const Vector3 o = p - centre;
    return Vector3(cos_yaw * o.x() - sin_yaw * o.y(), sin_yaw * o.x() + cos_yaw * o.y(), scale * o.z());
  }
  double scale;
};

std::vector<Mover> movers(const Adjustment& problem, const Corrections& at) {
  std::vector<Mover> out;
  out.reserve(static_cast<size_t>(at.rows()));
  for (Eigen::Index u = 0; u < at.rows(); ++u) {
    const double scale = std::exp(at(u, kScale));
    const Vector3 centre = problem.centre.row(u), shift = at.row(u).head<3>();
    out.push_back({scale * std::cos(at(u, kYaw)), scale * std::sin(at(u, kYaw)), at(u, kBias), centre,
                   centre + shift, scale});
  }
  return out;
}

}  // namespace

Column adjustment_residuals(const Adjustment& problem, const Corrections& at) {
  const auto users = movers(problem, at);
  Column out(problem.measured.size());
  for (Eigen::Index n = 0; n < out.size(); ++n) {
    const Mover& i = users[static_cast<size_t>(problem.user_i[n])];
    const Mover& j = users[static_cast<size_t>(problem.user_j[n])];
    const Vector3 between = i.arm(problem.p_i.row(n)) + i.moved - j.arm(problem.p_j.row(n)) - j.moved;
    out[n] = problem.measured[n] - between.norm() - i.bias - j.bias;
  }
  return out;
}

Adjusted adjust(const Adjustment& problem, Corrections at, const Numbers& free, const Column& prior_mean,
                const Column& prior_weight, int steps, double longest, double shortest) {
  const Eigen::Index size = kCorrections * at.rows();
  Eigen::MatrixXd all(size, size), normal = prior_weight.asDiagonal();
  Column slope(size);
  using Row = Eigen::Matrix<double, kCorrections, 1>;
  for (int step = 0; step < steps; ++step) {
    const auto users = movers(problem, at);
    all.setZero();
    slope.setZero();
    for (Eigen::Index n = 0; n < problem.measured.size(); ++n) {
      const Mover& i = users[static_cast<size_t>(problem.user_i[n])];
      const Mover& j = users[static_cast<size_t>(problem.user_j[n])];
      const Vector3 arm_i = i.arm(problem.p_i.row(n)), arm_j = j.arm(problem.p_j.row(n));
      const Vector3 between = arm_i + i.moved - arm_j - j.moved;
      const double distance = between.norm();
      const Vector3 d = between / std::max(distance, kNearest);
      const double residual = problem.measured[n] - distance - i.bias - j.bias;
      Row row_i, row_j;
      row_i << d, d.y() * arm_i.x() - d.x() * arm_i.y(), 1.0, d.dot(arm_i);
      row_j << -d, d.x() * arm_j.y() - d.y() * arm_j.x(), 1.0, -d.dot(arm_j);
      const double weight =
          1.0 / (problem.sigma * problem.sigma * (1.0 + std::pow(residual / problem.soft, 2)));
      const Eigen::Index a = Eigen::Index{kCorrections} * problem.user_i[n];
      const Eigen::Index b = Eigen::Index{kCorrections} * problem.user_j[n];
      all.block<kCorrections, kCorrections>(a, a).noalias() += weight * row_i * row_i.transpose();
      all.block<kCorrections, kCorrections>(b, b).noalias() += weight * row_j * row_j.transpose();
      all.block<kCorrections, kCorrections>(a, b).noalias() += weight * row_i * row_j.transpose();
      all.block<kCorrections, kCorrections>(b, a).noalias() += weight * row_j * row_i.transpose();
      slope.segment<kCorrections>(a) += weight * residual * row_i;
      slope.segment<kCorrections>(b) += weight * residual * row_j;
    }
    normal = all(free, free);
    normal.diagonal() += prior_weight;
    Eigen::Map<Column> flat(at.data(), size);
    const Column now = flat(free);
    const Column moved = normal.ldlt().solve(slope(free) + prior_weight.cwiseProduct(prior_mean - now));
    flat(free) = now + moved.cwiseMax(-longest).cwiseMin(longest);
    if (moved.size() == 0 || moved.cwiseAbs().maxCoeff() < shortest) break;
  }
  return {at, normal};
}

}  // namespace synchronizar
