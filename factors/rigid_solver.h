// The frames of k users whose SLAM, clocks and radios are trusted, most likely given ranges and priors.
//
// Of each free user x, y, z (m) and yaw (rad) of its frame are variables; the reference is where it is. All
// ranges of a pair are evaluated together: the row of a range is linear in five numbers, the unit direction
// and the moments of both arms (range_slot.h), so that a pair's rows sum to five columns' squares. The mean
// height of the origins, about which their prior is, is eliminated.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <vector>

#include "factors/height_search.h"
#include "factors/loss.h"
#include "factors/nlos_bursts.h"
#include "factors/pair_sums.h"
#include "factors/range_slot.h"
#include "factors/residual_statistics.h"

namespace synchronizar {

struct RigidRanges {
  Numbers first;                      // (p + 1) the first range of each pair of users, and the end
  Numbers user_i, user_j;             // (p)
  Column t;                           // (n) s, sorted within a pair
  Points i, j;                        // (n) antennas in their users' frames
  Column measured, sigma, nlos_odds;  // (n)
};

// As 1 sigma.
struct RigidPriors {
  Column height;        // (k) m, of each origin about the mean height, but for surveyed ones
  double place, yaw;    // of the free users' frames about where the optimisation begins
  Points survey;        // (k) m, where each was surveyed to be; NaN of who was not
  Column survey_sigma;  // (k) m, on each axis: Student's t ...
  double survey_dof;    // ... of so many degrees of freedom
};

struct RigidOptimum {
  Frames frames;
  Column nlos_odds;  // (n) of each range, given its neighbours in time
  double cost;       // of the bursts' chains and the heights
};

// Frames that somebody has come to before, and the distance (m and rad) within which they are the same.
struct Known {
  std::vector<Frames> frames;
  double same = 0.0;
};

// When expectation maximisation ends.
struct RigidStops {
  int rounds, steps;  // at most, and of Gauss-Newton in each
  double gain;        // of a round; a fourth of it in a step
  Known known;
  double hopeless = std::numeric_limits<double>::infinity();  // a cost that is given up after a round
};

class RigidSolver {
 public:
  using Marks = Eigen::Array<bool, Eigen::Dynamic, 1>;

  // `active` (k) are the users that have frames.
  RigidSolver(RigidRanges ranges, Marks active, int reference, RigidPriors priors, NlosMixture loss);

  Eigen::Index size() const { return ranges_.measured.size(); }
  Eigen::Index users() const { return active_.size(); }

  // Predicted minus measured (m).
  Column residuals(const Frames& frames) const;

  // The sum of the losses and the heights' prior; a part of it that is above `most` where it is.
  double cost(const Frames& frames, const Column& nlos_odds,
              double most = std::numeric_limits<double>::infinity()) const;

  // Odds of each range given its neighbours, and the cost of the chains and the heights.
  std::pair<Column, double> e_step(const Frames& frames, const Bursts& bursts) const;

  // A local optimum for given odds by Gauss-Newton with a backtracking line search, the priors of place and
  // yaw about `about`; or known frames on the way to it.
  Frames optimize(Frames frames, const Frames& about, const Column& nlos_odds, double annealing, int steps,
                  double gain, const Known& known = {}) const;

  // Optimises frames and estimates odds in turn.
  RigidOptimum run_em(Frames frames, Column nlos_odds, const Bursts& bursts, double annealing,
                      const RigidStops& stops) const;

  // Heights alone that explain the ranges as well, all else as in `frames` (height_search.h).
  std::vector<Heights> other_heights(const Frames& frames, const Column& nlos_odds, double most_above,
                                     int most) const;

  // (4 k, 4) covariance of each user's frame at a local optimum, 0 of what is fixed. Where the distances'
  // curvature bends the cost downwards between two equally good heights it counts as far as a tenth of the
  // information is left.
  Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor> covariances(const Frames& frames,
                                                                        const Column& nlos_odds) const;

 private:
  // The cost is near its value here, which is `cost`, plus gradient' d + d' matrix d / 2: Gauss-Newton with
  // the pairs' curvature in height where that is positive. `downwards` is the negative one. Lower triangles.
  struct System {
    Eigen::MatrixXd matrix, downwards;
    Column gradient;
    double cost = 0.0;
    bool bends_down = false;
  };
  void linearize(const Frames& frames, const Frames& about, const Column& surveys, const Eigen::ArrayXd& late,
                 double annealing, System& out) const;
  Eigen::Index pairs() const { return ranges_.user_i.size(); }
  // Of the heights about their mean, and of the surveyed places.
  double prior_cost(const Frames& frames) const;
  bool is_surveyed(Eigen::Index user) const { return !std::isnan(priors_.survey(user, 0)); }
  // (k) 1/m^2: the information that each survey is at these frames, Student's t being a scale mixture.
  Column survey_information(const Frames& frames) const;
  double mean_height(const Frames& frames) const;
  Eigen::ArrayXd late_density(const Column& nlos_odds) const;
  Frames moved(const Frames& frames, const Column& step, double length) const;
  bool is_known(const Frames& frames, const Known& known) const;

  RigidRanges ranges_;
  Marks active_;
  Numbers at_;  // (k) the first of each user's variables; -1: fixed
  int variables_ = 0;
  RigidPriors priors_;
  Column height_weight_;
  double height_weights_ = 0.0;
  NlosMixture loss_;
  pair_sums::Columns columns_;
};

}  // namespace synchronizar
