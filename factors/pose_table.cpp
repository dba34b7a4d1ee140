#include "factors/pose_table.h"

#include <algorithm>

namespace synchronizar {

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

}  // namespace synchronizar
