// Rigid walks moved until ranges between them fit: each user by x, y, z, a turn about z, its radio's bias and
// a scale, about a centre of its own.
//
// With s = exp(scale) an antenna at p lies at q = s R(yaw) (p - centre) + centre + (x, y, z), and a range is
// |q_i - q_j| + bias_i + bias_j. Its loss is that of Cauchy with `soft` in m.
#pragma once

#include "factors/range_slot.h"

namespace synchronizar {

constexpr int kCorrections = 6;  // x, y, z, yaw, bias, scale
using Corrections = Eigen::Matrix<double, Eigen::Dynamic, kCorrections, Eigen::RowMajor>;

struct Adjustment {
  Numbers user_i, user_j;  // (n)
  Points p_i, p_j;         // (n, 3) m
  Column measured;         // (n) m
  Points centre;           // (k, 3) m
  double sigma, soft;      // m
};

// Measured minus predicted (m).
Column adjustment_residuals(const Adjustment& problem, const Corrections& at);

// Corrections near the ones given, and the normal matrix of the last step over the variables `free` (numbered
// row by row). Gauss-Newton, whose steps are no longer than `longest` in any variable, until one is shorter
// than `shortest` in all; `prior_mean` and `prior_weight` are of the free variables.
struct Adjusted {
  Corrections at;
  Eigen::MatrixXd normal;
};
Adjusted adjust(const Adjustment& problem, Corrections at, const Numbers& free, const Column& prior_mean,
                const Column& prior_weight, int steps, double longest, double shortest);

}  // namespace synchronizar
