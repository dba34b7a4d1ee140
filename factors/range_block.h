// Many ranges between the antennas of the same two users (and, where poses are variables, of the same two
// keyframes), evaluated in one call.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "factors/loss.h"
#include "factors/range.h"

namespace synchronizar {

using Points = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Column = Eigen::VectorXd;

class RangeBlock {
 public:
  // N antenna positions of each user in its local frame (m), N measured distances (m), sigmas (m, > 0) and
  // NLOS odds (>= 0). The caller has checked the shapes.
  RangeBlock(Points o_i, Points o_j, Column measured, Column sigma, Column nlos_odds);

  // The same ranges with N other NLOS odds.
  RangeBlock with_nlos_odds(Column nlos_odds) const;

  Eigen::Index size() const { return measured_.size(); }

  // N residuals (m), predicted minus measured.
  Column residuals(const UserPose& i, const UserPose& j) const;

  // Negative log likelihood: the sum of the losses.
  double cost(const UserPose& i, const UserPose& j, const Loss& loss) const;

  // The cost at every height difference between the two users' origins from -zero to zero times `step` (m),
  // all else fixed; that of an even selection of `most_ranges`, scaled to all.
  Column height_profile(const UserPose& i, const UserPose& j, const LossKind& loss, double step, int zero,
                        int most_ranges) const;

  // A quadratic model of the cost at these poses, as square-root information: five rows [A b] over i's 8
  // columns, j's 8 columns and a residual. A' b is the exact gradient of the cost, and A' A its Hessian
  // without the parts that could make it indefinite: the losses' curvature rho'' is at least a tenth of the
  // weight, and of the distances' curvature there is only that in height, (1 - e_z^2) / d, where its sum over
  // all ranges is positive. On a level walk only that curvature makes heights observable, and Gauss-Newton
  // without it takes ten times as many steps. For squared losses and ranges that fit, A' A is the sum of the
  // single rows' squares. A QR of the lines' coordinates gives the rows (range.h): no normal equations are
  // formed.
  static constexpr int kRows = 5;
  using SquareRoot = Eigen::Matrix<double, kRows, 2 * kUserColumns + 1>;
  SquareRoot square_root(const UserPose& i, const UserPose& j, const Loss& loss) const;

  // Second derivative (1/m^2) of the cost in the height difference by the curvature of the distances, of
  // either sign: the sum of rho' (1 - e_z^2) / (d sigma). `square_root` contains it where it is positive.
  double height_curvature(const UserPose& i, const UserPose& j, const Loss& loss) const;

  // The weight rho'(e) / e (without 1 / sigma^2) that the loss gives each range at these poses.
  Column weights(const UserPose& i, const UserPose& j, const Loss& loss) const;

  // The probability that each range is line-of-sight at these poses.
  Column inlier_probability(const UserPose& i, const UserPose& j, const NlosMixture& nlos) const;

 private:
  template <class Visit>
  void for_each_line(const UserPose& i, const UserPose& j, Visit visit) const;
  RangeTraits traits(Eigen::Index n) const { return {sigma_[n], nlos_odds_[n]}; }

  Points o_i_, o_j_;
  Column measured_, sigma_, nlos_odds_;
};

}  // namespace synchronizar
