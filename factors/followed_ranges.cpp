#include "factors/followed_ranges.h"

#include <cmath>

namespace synchronizar {

FollowedApart followed_apart(const FollowedRanges& ranges, const FollowedColumns& columns,
                             const Eigen::Ref<const FollowedStates>& states, Eigen::Index users,
                             Eigen::Index first) {
  // Of each state: cosine and sine of yaw, scale.
  Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> turned(states.rows(), 3);
  turned.col(0) = states.col(2).array().cos();
  turned.col(1) = states.col(2).array().sin();
  turned.col(2) = states.col(4).array().exp();
  FollowedApart out{Points(ranges.rows(), 3), Column(ranges.rows()), Column(ranges.rows())};
  for (Eigen::Index n = 0; n < ranges.rows(); ++n) {
    const auto row = ranges.row(n);
    const Eigen::Index begin = (static_cast<Eigen::Index>(row[columns.slot]) - first) * users;
    const auto antenna = [&](Eigen::Index at, Eigen::Index end) {
      const auto state = states.row(at);
      const Vector3 arm = turned(at, 2) * row.segment<3>(end).transpose() +
                          row.segment<3>(end + 3).transpose() +
                          state[6] * row.segment<3>(end + 6).transpose();
      const double c = turned(at, 0), s = turned(at, 1);
      return Vector3(state[0] + c * arm.x() - s * arm.y(), state[1] + s * arm.x() + c * arm.y(),
                     state[3] + arm.z());
    };
    const Eigen::Index i = begin + static_cast<Eigen::Index>(row[columns.user_i]);
    const Eigen::Index j = begin + static_cast<Eigen::Index>(row[columns.user_j]);
    const Vector3 away = antenna(i, columns.end_i) - antenna(j, columns.end_j);
    out.away.row(n) = away.transpose();
    out.bias[n] = states(i, 5) + states(j, 5);
    out.residual[n] = away.norm() + out.bias[n] - row[columns.measured];
  }
  return out;
}

}  // namespace synchronizar
