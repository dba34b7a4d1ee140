// A device's poses at given times, from a table of poses with rising stamps.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "factors/range_slot.h"

namespace synchronizar {

// Rows of poses, and which columns are the stamp (s), and the first of three of the position and of four of
// the attitude (x y z w).
struct PoseColumns {
  Eigen::Index stamp, position, attitude;
};
using PoseTable = Eigen::Ref<const Matrix, 0, Eigen::OuterStride<>>;

struct PosesAt {
  Points position;
  Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor> attitude;
  Eigen::Array<bool, Eigen::Dynamic, 1> valid;
};

// Positions interpolated linearly, attitudes along the shorter chord. A time before the first stamp, after
// the last, or inside a gap longer than `longest` s is not valid; there must be a pose.
PosesAt poses_at(const PoseTable& table, const PoseColumns& columns, const Column& t, double longest);

// Ends of ranges, as ranges of followed users have them (followed_ranges.h): of i and of j in turn the
// device's position, the lever to its antenna (m), and the antenna's velocity (m/s).
constexpr int kEndColumns = 9;
using RangeEnds = Eigen::Matrix<double, Eigen::Dynamic, 2 * kEndColumns, Eigen::RowMajor>;
struct RangesRead {
  RangeEnds ends;
  Eigen::Array<bool, Eigen::Dynamic, 1> valid;  // whether the poses of both are known
};

// A device as ranges are read by it.
struct RangingDevice {
  const PoseTable* table;  // nullptr: it stands at its origin; without rows: nothing is known of it
  double clock;            // s: its stamps minus the ranges'
};

// Of ranges at times t, between the devices `users`, by antennas that `levers` (body axes) lead to: row 2 n
// is that of i. Velocities are means from `reach` s before to as long after, or to the last pose, as far as
// poses are known. Ranges that are not `wanted` are left at 0, and not valid.
RangesRead read_ranges(const std::vector<RangingDevice>& devices, const PoseColumns& columns, const Column& t,
                       const Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor>& users,
                       const Points& levers, const Eigen::Array<bool, Eigen::Dynamic, 1>& wanted,
                       double reach, double longest);

}  // namespace synchronizar
