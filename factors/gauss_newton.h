// What solvers by Gauss-Newton steps with a backtracking line search have in common.
#pragma once

#include <cmath>

namespace synchronizar {

inline constexpr double kSufficient =
    1e-4;                                  // of the gain that the linear model predicts (Armijo's condition)
inline constexpr double kShorter = 0.4;    // factor on the step's length at each attempt
inline constexpr double kShortest = 1e-3;  // of the full step

inline constexpr double kFullTurn = 6.283185307179586;

inline double wrapped(double angle) { return std::remainder(angle, kFullTurn); }

}  // namespace synchronizar
