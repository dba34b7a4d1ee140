// Whether ranges of the last moments, as they came and before they were used, contradict where users are
// taken to be: a table of innovations, looked at over stretches of time.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "factors/loss.h"
#include "factors/nlos_bursts.h"
#include "factors/range_slot.h"

namespace synchronizar {

// Columns of a table of innovations: s, both users, predicted minus measured over what is expected, (3,) m
// from j's antenna to i's as predicted, m as measured without what radios add, m 1 sigma, prior odds of NLOS,
// what such a range is worth.
enum InnovationColumn : std::uint8_t {
  kStamp,
  kUserI,
  kUserJ,
  kWhitened,
  kAway,
  kMeasured = kAway + 3,
  kSigma,
  kOdds,
  kWeight,
  kInnovationColumns
};
using Innovations = Eigen::Ref<const Matrix, 0, Eigen::OuterStride<>>;

// Since when ranges count, and up to when; whether a shift begins then and grows evenly, or is there all
// along.
struct Stretch {
  double since, until;
  bool grows;
};

struct ShiftLimits {
  double fewest;     // ranges, in all and of a group
  double sigma;      // m, of a shift's prior
  double looked_at;  // log likelihood by the linear score, from which on a shift is fitted
};

struct GroupShift {
  std::vector<int> users;
  Eigen::Vector3d shift;  // m, at the end
  double gain;            // log likelihood
};

// Groups of users whose ranges one shift of theirs explains better, the best first.
//
// If a group is off by one shift, its ranges to the others show it, and those among itself do not. A linear
// score of every group of one or two, from sums over pairs, says which are worth a closer look; for these the
// shift is fitted (common_shift.h).
std::vector<GroupShift> shifted_groups(const Innovations& rows, const Stretch& stretch,
                                       const ShiftLimits& limits, const NlosMixture& loss,
                                       const Bursts& bursts);

struct MisfitLimits {
  double sigmas;        // from which on a range is off
  double fewest, many;  // ranges of a user: that tell anything, and for which all that is off counts
  double short_share;   // of a user's ranges that may be too short
  double off_share;     // and too short or too long; only over stretches that are `lasting`
  bool lasting;
};

struct Misfit {
  int user;
  double share;  // of its ranges that do not fit
};

// The user that fits worst since then, where that is more than chance: three standard deviations of a
// binomial count beyond the share that may be too short.
std::optional<Misfit> worst_misfit(const Innovations& rows, double since, const MisfitLimits& limits);

}  // namespace synchronizar
