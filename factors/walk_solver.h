// The walks of k users and their devices' calibrations, most likely given SLAM's steps, ranges and priors.
//
// The variables are places: of each keyframe x, y, z (m) and yaw (rad) in the common frame; of each device
// the log scale, the bias and the clock offset; the calibration that all devices share, and the mean height
// of the users' origins. A step between keyframes has the residual
//
//   R(-yaw_n) (p_{n+1} - p_n)_xy / s - slam_xy,   (z_{n+1} - z_n) / s - slam_z,   yaw_{n+1} - yaw_n
//
// over its sigmas, with s the device's scale; ranges are those of calibrated_range.h with the keyframe as the
// frame. The reference's first keyframe is fixed at SLAM's own pose: (0, 0, s z_0) and yaw 0.
//
// A range may besides have an error that lasts, of its pair and some time: v variables, each of which is
// stationary with its own 1 sigma and correlated with the one that it follows (a first-order autoregression,
// the Ornstein-Uhlenbeck process seen at times).
//
// Keyframes are grouped by time, so that steps and ranges connect a group with itself and the one before
// (with one further back after a gap in a track): the matrix of the normal equations is a block envelope with
// a border of what all groups share, which are calibrations and users with one keyframe.
#pragma once

#include <utility>
#include <vector>

#include "factors/range_slot.h"

namespace synchronizar {

// m keyframes, sorted by user.
struct Walks {
  int users;
  int reference;
  Numbers first;  // (k + 1) the first keyframe of each user, and the end
  Column t;       // (m) s by the range clock
  Points slam;    // (m, 3) SLAM units, each in its user's own frame, x and y from the first keyframe
  Numbers keyframe_i, keyframe_j;  // (n) keyframes of each range
  Antennas i, j;                   // (n) in their axes
  Column measured, sigma;          // (n)
  Numbers lasting;                 // (n) which lasting error each range has; empty where v = 0
  Numbers follows;                 // (v) the one before, or -1
  Column decay;                    // (v) correlation with it; 0 where there is none
};

using WalkPlaces = Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>;
using ThreeColumns = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Marks = Eigen::Array<bool, Eigen::Dynamic, 1>;

// Weights and priors, all as 1 sigma; the EM weights are in them.
struct WalkNoise {
  Column nlos_odds, range_weight;  // (n)
  ThreeColumns step_sigma;    // (m) of the step to each keyframe: in the plane (m), height (m), yaw (rad)
  WalkPlaces about;           // (k) prior mean of each first keyframe's x, y and yaw
  Column place_sigma;         // (k) of x and y, for all but the reference
  double yaw_sigma;           // of the yaws
  Column height_sigma;        // (k) m, of each origin about the mean height, or about `about`'s z where ...
  Marks surveyed;             // (k) ... its place was surveyed
  ThreeColumns device_sigma;  // (k) of each calibration about the shared one
  Column known_bias_sigma;    // (k) m, of each bias about 0, besides; infinite where nothing is known of it
  Vector3 shared_sigma;       // of the shared one about 0
  Column assumed_clock;       // (k) s, at which the antennas were read
  Column lasting_sigma;       // (v) m, of each lasting error by itself
};

struct WalkStates {
  WalkPlaces places;         // (m)
  ThreeColumns calibration;  // (k) clock offsets are not relative to the assumed ones
  Column lasting;            // (v) m, what a range is longer by
};

// A symmetric positive definite matrix in groups of rows, and then its Cholesky decomposition: each group has
// blocks from the first group that it is connected with to itself. The border is a group connected with all.
class BorderedEnvelope {
 public:
  // The sizes of all groups, and of each the first one that it is connected with.
  BorderedEnvelope(std::vector<int> sizes, std::vector<int> first);

  int groups() const { return static_cast<int>(sizes_.size()); }
  int size(int group) const { return sizes_[static_cast<size_t>(group)]; }

  // The rows of group a and the columns of group b, b <= a.
  Eigen::MatrixXd& block(int a, int b) { return blocks_[at(a, b)]; }
  const Eigen::MatrixXd& block(int a, int b) const { return blocks_[at(a, b)]; }

  // A factor on the diagonal.
  void damp(double factor);

  // In place; false where it is not positive definite.
  bool factorize();

  // Of the matrix, by its decomposition.
  double log_determinant() const;

  // The solutions for right-hand sides, rows by group, in place; of a decomposition.
  using Sides = std::vector<Eigen::MatrixXd>;
  void solve(Sides& sides) const;

  // The inverse where there are blocks; of a decomposition.
  BorderedEnvelope inverse() const;

 private:
  size_t at(int a, int b) const { return begin_[static_cast<size_t>(a)] + static_cast<size_t>(b - from(a)); }
  int from(int group) const { return first_[static_cast<size_t>(group)]; }

  std::vector<int> sizes_, first_;
  std::vector<size_t> begin_;
  std::vector<Eigen::MatrixXd> blocks_;
};

// The noise of k users' steps about a common factor on it.
struct StepNoise {
  // (k, 2) the most likely factors on each user's step sigmas in place and heading, by expectation
  // maximisation; the prior counts as so many steps with the common factor.
  Eigen::MatrixXd factors;
  double evidence;  // logarithm of the marginal likelihood at these factors, with their prior
  // Errors of steps that the ranges determine: the sum of 1 minus posterior over prior variance; NaN where
  // the evidence is hopelessly less than that of others, and the users' own factors are not sought.
  double determined;
};

class WalkSolver {
 public:
  explicit WalkSolver(Walks walks);

  const Walks& walks() const { return walks_; }

  // Predicted minus measured (m), of each range.
  Column residuals(const WalkStates& states, const Column& assumed_clock) const;

  // Negative log likelihood, at the most likely shared calibration and mean height.
  double cost(const WalkStates& states, const WalkNoise& noise, const Loss& loss) const;

  // The gradient of the cost by the places and the calibrations; 0 by what is fixed.
  WalkStates gradient(const WalkStates& states, const WalkNoise& noise, const Loss& loss) const;

  // A local optimum by Gauss-Newton with a backtracking line search: at most `steps` steps, until one gains
  // less than `gain`.
  WalkStates optimize(WalkStates states, const WalkNoise& noise, const Loss& loss, int steps,
                      double gain) const;

  // The joint covariance of some keyframes' x, y, z, yaw (4 each), then of all calibrations (3 each) at a
  // local optimum; 0 of what is fixed. `height_curvature` (n, 1/m^2) replaces the ranges' own.
  Eigen::MatrixXd covariance(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                             const Column& height_curvature, const Numbers& keyframes) const;

  // The logarithm of the determinant of the cost's second derivatives at a local optimum: with the cost, what
  // Laplace's approximation of the evidence needs. `height_curvature` as above.
  double log_determinant(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                         const Column& height_curvature) const;

  // What the ranges say of the noise of SLAM's steps, in the system linearised at these states, were it about
  // each of `tried` (b) times what it is; users' own factors are sought from `begin` times that on. Steps to
  // the keyframes `counted` (m) have the factors, others stay as they are. Only the keyframes `kept` (m), a
  // run of each user, and the ranges between them are in it.
  std::vector<StepNoise> step_noise(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                                    const Marks& kept, const Marks& counted, const Column& tried,
                                    double begin, double weight, int rounds) const;

 private:
  // Where a variable is: a group (the border is the last one) and its offset there; -1 if it is fixed.
  struct Where {
    int group = -1, offset = 0;
  };
  // Height curvature (1/m^2) of a run of ranges between two keyframes.
  struct Bend {
    int key_i, key_j;
    double information;
  };
  // The normal equations: the cost is near its value here, which is `cost`, plus gradient' d + d' matrix d
  // / 2. `downwards` are bends that are negative and not in the matrix: with them it is nearer to the cost's
  // second derivatives, but may be indefinite.
  struct System {
    BorderedEnvelope matrix;
    BorderedEnvelope::Sides gradient;
    double cost = 0.0;
    std::vector<Bend> downwards;

    template <class Block>
    void add(const Where& a, const Where& b, const Block& values);
    template <class Block>
    void add_gradient(const Where& at, const Block& values);
  };
  struct Step;

  System zero() const;
  System linearized(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                    const Column* height_curvature = nullptr, const Marks* without_steps_to = nullptr) const;
  void add_ranges(System& system, const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                  const Column* height_curvature) const;
  void bend(System& system, const Bend& by, const WalkStates& states) const;
  void add_priors(System& system, const WalkStates& states, const WalkNoise& noise) const;
  void add(System& system, const Step& step) const;
  Step step_to(int keyframe, const WalkStates& states, const Vector3& sigma) const;
  double prior_cost(const WalkStates& states, const WalkNoise& noise) const;
  // Of a lasting error beside the one that it follows, over the 1 sigma of their difference.
  double lasting_step(int which, const WalkStates& states, const WalkNoise& noise) const;
  double lasting_of(Eigen::Index range, const WalkStates& states) const;
  WalkStates moved(const WalkStates& states, const BorderedEnvelope::Sides& step, double length) const;
  std::vector<StepNoise> step_noise(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                                    const Marks& counted, const Column& tried, double begin, double weight,
                                    int rounds) const;
  // The decomposition with steps whose noise has `factors`, the Newton step, and the evidence of the factors.
  struct WithSteps {
    BorderedEnvelope matrix;
    BorderedEnvelope::Sides step;
    double evidence;
  };
  WithSteps with_steps(double about, const Eigen::MatrixXd& factors, const System& others,
                       const WalkStates& states, const WalkNoise& noise, const Marks& counted,
                       double weight) const;
  void maximize(double about, StepNoise& out, const System& others, const WalkStates& states,
                const WalkNoise& noise, const Marks& counted, double weight, int rounds) const;
  std::vector<DeviceAtKeyframe> devices(const WalkStates& states, const Column& assumed_clock) const;
  Vector3 shared_calibration(const WalkStates& states, const WalkNoise& noise) const;
  double mean_height(const WalkStates& states, const WalkNoise& noise) const;
  double height_of_origin(int user, const WalkStates& states) const;
  // The derivative of a keyframe's height by its device's log scale where the keyframe is fixed.
  double height_by_scale(int keyframe, const WalkStates& states) const;

  Walks walks_;
  Numbers user_;  // (m) of each keyframe
  std::vector<int> sizes_, connected_from_;
  std::vector<Where> keyframe_at_, device_at_, lasting_at_;  // (m), (k), (v)
  Where shared_at_, mean_height_at_;
};

}  // namespace synchronizar
