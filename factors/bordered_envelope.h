// Sparse Cholesky decomposition of normal equations whose variables are grouped by time.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace synchronizar {

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

}  // namespace synchronizar
