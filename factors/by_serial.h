// What is known of ranges that have a running index, laid beside other ranges.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "factors/range_slot.h"

namespace synchronizar {

// Rows of numbers, each of the range with a running index.
struct SerialRows {
  Numbers serial;
  Matrix values;
};

struct FoundRows {
  Eigen::Array<bool, Eigen::Dynamic, 1> known;
  Matrix values;  // `unknown` where nothing is known
};

// Of ranges by running index what the last of the tables says that knows them; all tables have as many
// columns as `unknown`.
FoundRows rows_by_serial(const Numbers& serial, const std::vector<SerialRows>& tables, const Column& unknown);

}  // namespace synchronizar
