// What the ranges between two rigid walks sum to: their losses, and the squares of their rows.
//
// The row of a range is linear in five numbers (range_slot.h): the unit direction and the moments of both
// arms. Ranges are kept by columns in blocks of `kBlock`, which compilers turn into vector instructions.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "factors/loss.h"
#include "factors/range_block.h"

namespace synchronizar::pair_sums {

constexpr int kBlock = 32;
constexpr int kNumbers = 5;

struct Place {
  double x, y, z, cos_yaw, sin_yaw;

  explicit Place(const UserPose& frame);
};

struct Sums {
  std::array<std::array<double, kNumbers>, kNumbers> squares{};  // upper triangle
  std::array<double, kNumbers> gradient{};
  double cost = 0.0;
  double bend = 0.0;  // 1/m^2, curvature in height
};

// The ranges of some pairs. Rows that fill up a pair's last block weigh nothing.
class Columns {
 public:
  // Rows for pairs of so many ranges.
  explicit Columns(const std::vector<Eigen::Index>& counts);

  // The ranges of a pair; the rows of the given matrices are taken one after the other.
  void fill(Eigen::Index pair, const Eigen::Ref<const Points>& i, const Eigen::Ref<const Points>& j,
            const Eigen::Ref<const Column>& measured, const Eigen::Ref<const Column>& sigma);

  // NLOS odds of a pair's ranges as rows of `late`, the ratio of the densities of the loss.
  void fill_late(Eigen::Index pair, const Eigen::Ref<const Column>& sigma,
                 const Eigen::Ref<const Column>& nlos_odds, const NlosMixture& loss,
                 Eigen::ArrayXd& late) const;

  Eigen::Index rows() const { return values_.rows(); }
  Eigen::Index begin(Eigen::Index pair) const { return begin_[static_cast<size_t>(pair)]; }
  Eigen::Index end(Eigen::Index pair) const { return begin_[static_cast<size_t>(pair) + 1]; }
  const double* data() const { return values_.data(); }

 private:
  std::vector<Eigen::Index> begin_;
  Eigen::ArrayXXd values_;
};

// Under the loss NlosMixture, annealed.
Sums nlos_mixture(const Columns& columns, Eigen::Index pair, const Place& i, const Place& j,
                  const NlosMixture& loss, double annealing, const Eigen::ArrayXd& late);

// The cost alone.
double nlos_mixture_cost(const Columns& columns, Eigen::Index pair, const Place& i, const Place& j,
                         const NlosMixture& loss, double annealing, const Eigen::ArrayXd& late);

// The same, each row's information being the loss's weight (iteratively reweighted least squares).
Sums reweighted(const Columns& columns, Eigen::Index pair, const Place& i, const Place& j,
                const NlosMixture& loss, const Eigen::ArrayXd& late);
Sums reweighted(const Columns& columns, Eigen::Index pair, const Place& i, const Place& j,
                const GemanMcClure& loss);

}  // namespace synchronizar::pair_sums
