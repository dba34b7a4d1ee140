#include "factors/residual_statistics.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace synchronizar {
namespace {

using std::size_t;

constexpr double kObserved = 1e-9;  // of the largest eigenvalue of the information

struct OfUser {
  Eigen::Matrix4d information = Eigen::Matrix4d::Zero();
  std::vector<Eigen::Vector4d> scores;

  double inflation() const {
    if (scores.empty()) return 1.0;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> of(information);
    const Eigen::Vector4d& values = of.eigenvalues();
    Eigen::Array4d squares = Eigen::Array4d::Zero();
    for (const Eigen::Vector4d& score : scores)
      squares += (of.eigenvectors().transpose() * score).array().square();
    int rank = 0;
    double sum = 0.0;
    for (int a = 0; a < 4; ++a) {
      if (!(values[a] > kObserved * std::max(values[3], 1e-300))) continue;
      ++rank;
      sum += squares[a] / values[a];
    }
    if (rank == 0) return 1.0;
    const double by_chance = 1.0 + 2.0 * std::sqrt(2.0 / (rank * static_cast<double>(scores.size())));
    return std::max(1.0, sum / rank / by_chance);
  }
};

}  // namespace

Column residual_inflations(const PairedRanges& ranges, const Frames& frames, const Column& residual,
                           const Column& weight, int pieces) {
  std::vector<OfUser> users(static_cast<size_t>(frames.rows()));
  Column out(frames.rows());
  const Eigen::Index n = ranges.t.size();
  const double begin = n > 0 ? ranges.t.minCoeff() : 0.0;
  const double span = n > 0 ? std::max(ranges.t.maxCoeff() - begin, 1e-9) : 1.0;
  const auto piece = [&](Eigen::Index k) {
    return std::min(static_cast<int>((ranges.t[k] - begin) / span * pieces), pieces - 1);
  };
  for (Eigen::Index p = 0; p < ranges.user_i.size(); ++p) {
    const auto placed = [&](int user) {
      const auto f = frames.row(user);
      return CommonFromLocal(UserPose{f[0], f[1], f[3], f[2]});
    };
    OfUser& i = users[static_cast<size_t>(ranges.user_i[p])];
    OfUser& j = users[static_cast<size_t>(ranges.user_j[p])];
    const CommonFromLocal from_i = placed(ranges.user_i[p]), from_j = placed(ranges.user_j[p]);
    for (Eigen::Index k = ranges.first[p]; k < ranges.first[p + 1]; ++k) {
      if (k == ranges.first[p] || piece(k) != piece(k - 1)) {
        i.scores.emplace_back(Eigen::Vector4d::Zero());
        j.scores.emplace_back(Eigen::Vector4d::Zero());
      }
      const Vector3 q_i = from_i(ranges.i.row(k)), q_j = from_j(ranges.j.row(k));
      const Vector3 e = Line(q_i, q_j).direction;
      const auto add = [&](OfUser& user, const Vector3& arm) {
        const Eigen::Vector4d row(e.x(), e.y(), e.z(), e.y() * arm.x() - e.x() * arm.y());
        user.information.noalias() += weight[k] * row * row.transpose();
        user.scores.back() += weight[k] * residual[k] * row;
      };
      add(i, q_i - from_i.origin);
      add(j, q_j - from_j.origin);
    }
  }
  for (size_t u = 0; u < users.size(); ++u) out[static_cast<Eigen::Index>(u)] = users[u].inflation();
  return out;
}

}  // namespace synchronizar
