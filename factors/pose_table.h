// A device's poses at given times, from a table of poses with rising stamps.
#pragma once

#include <Eigen/Core>

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

}  // namespace synchronizar
