// The normal equations of walks: near some states the cost is `cost` + gradient' d + d' matrix d / 2.
#pragma once

#include <vector>

#include "factors/bordered_envelope.h"
#include "factors/walk_layout.h"

namespace synchronizar {

// Height curvature (1/m^2) of a run of ranges between two keyframes.
struct HeightBend {
  int key_i, key_j;
  double information;
};

struct WalkSystem {
  explicit WalkSystem(const WalkLayout& layout) : matrix(layout.sizes(), layout.connected_from()) {
    for (const int size : layout.sizes()) gradient.emplace_back(Eigen::MatrixXd::Zero(size, 1));
  }

  // What is fixed has no rows, and nothing is added to it.
  template <class Block>
  void add(const Where& a, const Where& b, const Block& values) {
    if (a.group < 0 || b.group < 0) return;
    constexpr int kRows = Block::RowsAtCompileTime, kColumns = Block::ColsAtCompileTime;
    if (a.group > b.group || (a.group == b.group && a.offset >= b.offset)) {
      matrix.block(a.group, b.group).block<kRows, kColumns>(a.offset, b.offset) += values;
    } else {
      matrix.block(b.group, a.group).block<kColumns, kRows>(b.offset, a.offset) += values.transpose();
    }
  }
  template <class Block>
  void add_gradient(const Where& at, const Block& values) {
    if (at.group < 0) return;
    gradient[static_cast<size_t>(at.group)].block<Block::RowsAtCompileTime, 1>(at.offset, 0) += values;
  }

  BorderedEnvelope matrix;
  BorderedEnvelope::Sides gradient;
  double cost = 0.0;
  // Bends that are negative and not in the matrix: with them it is nearer to the cost's second derivatives,
  // but may be indefinite.
  std::vector<HeightBend> downwards;
};

using OneByOne = Eigen::Matrix<double, 1, 1>;

}  // namespace synchronizar
