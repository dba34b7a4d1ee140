#include "factors/pose_table.h"

#include <Eigen/Geometry>
#include <algorithm>

namespace synchronizar {
namespace {

constexpr double kShortest = 1e-3;  // s: over less, a velocity is not told

}  // namespace

PosesAt poses_at(const PoseTable& table, const PoseColumns& columns, const Column& t, double longest) {
  const Eigen::Index last = table.rows() - 1;
  const auto stamp = [&](Eigen::Index row) { return table(row, columns.stamp); };
  PosesAt out{Points(t.size(), 3), decltype(PosesAt::attitude)(t.size(), 4),
              decltype(PosesAt::valid)(t.size())};
  for (Eigen::Index n = 0; n < t.size(); ++n) {
    Eigen::Index low = 0, high = last + 1;  // the first row whose stamp is not before t
    while (low < high) {
      const Eigen::Index middle = (low + high) / 2;
      if (stamp(middle) < t[n]) {
        low = middle + 1;
      } else {
        high = middle;
      }
    }
    const Eigen::Index after = std::clamp(low, std::min<Eigen::Index>(1, last), last);
    const Eigen::Index before = std::max<Eigen::Index>(after - 1, 0);
    const double gap = stamp(after) - stamp(before);
    const bool at_a_stamp = t[n] == stamp(after) || t[n] == stamp(before);
    out.valid[n] = t[n] >= stamp(0) && t[n] <= stamp(last) && (gap <= longest || at_a_stamp);
    const double u = gap > 0.0 ? std::clamp((t[n] - stamp(before)) / gap, 0.0, 1.0) : 0.0;
    const auto a = table.row(before), b = table.row(after);
    out.position.row(n) = (1.0 - u) * a.segment<3>(columns.position) + u * b.segment<3>(columns.position);
    const auto q0 = a.segment<4>(columns.attitude), q1 = b.segment<4>(columns.attitude);
    const double sign = q0.dot(q1) < 0.0 ? -1.0 : 1.0;
    out.attitude.row(n) = ((1.0 - u) * q0 + u * sign * q1).normalized();
  }
  return out;
}

RangesRead read_ranges(const std::vector<RangingDevice>& devices, const PoseColumns& columns, const Column& t,
                       const Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor>& users,
                       const Points& levers, const Eigen::Array<bool, Eigen::Dynamic, 1>& wanted,
                       double reach, double longest) {
  RangesRead out{RangeEnds::Zero(t.size(), RangeEnds::ColsAtCompileTime), wanted};
  Column stamps(3);
  for (Eigen::Index n = 0; n < t.size(); ++n) {
    for (Eigen::Index end = 0; end < 2; ++end) {
      const RangingDevice& device = devices[static_cast<std::size_t>(users(n, end))];
      if (!out.valid[n] || device.table == nullptr) continue;
      const Eigen::Index last = device.table->rows() - 1;
      if (last < 0) {
        out.valid[n] = false;
        continue;
      }
      const double at = t[n] + device.clock;
      stamps << at, at - reach, std::min(at + reach, std::max((*device.table)(last, columns.stamp), at));
      const PosesAt poses = poses_at(*device.table, columns, stamps, longest);
      const auto lever_at = [&](Eigen::Index pose) -> Vector3 {
        const Eigen::Vector4d q = poses.attitude.row(pose).transpose();
        return Eigen::Quaterniond(q[3], q[0], q[1], q[2]) * levers.row(2 * n + end).transpose();
      };
      const Eigen::Index begin = poses.valid[1] ? 1 : 0, until = poses.valid[2] ? 2 : 0;
      const Vector3 moved = (poses.position.row(until) - poses.position.row(begin)).transpose() +
                            lever_at(until) - lever_at(begin);
      auto row = out.ends.row(n).segment<kEndColumns>(end * kEndColumns);
      row << poses.position.row(0), lever_at(0).transpose(),
          moved.transpose() / std::max(stamps[until] - stamps[begin], kShortest);
      out.valid[n] = poses.valid[0];
    }
  }
  return out;
}

}  // namespace synchronizar
