// Any number of rows [A b] squeezed to a triangle with the same A' A and A' b: a QR in chunks, so that memory
// stays bounded and no normal equations are formed.
#pragma once

#include <Eigen/Core>
#include <Eigen/QR>

namespace synchronizar {

template <int kColumns>
class Squeeze {
 public:
  using Triangle = Eigen::Matrix<double, kColumns, kColumns>;

  Squeeze() : rows_(kChunk + kColumns, static_cast<Eigen::Index>(kColumns)) {
    rows_.template topRows<kColumns>().setZero();
  }

  // The next row, zeros, to be filled in.
  auto next() {
    if (filled_ == rows_.rows()) squeeze();
    rows_.row(filled_).setZero();
    return rows_.row(filled_++);
  }

  Triangle triangle() {
    squeeze();
    return rows_.template topRows<kColumns>();
  }

 private:
  static constexpr Eigen::Index kChunk = 512;
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, kColumns, Eigen::ColMajor, kChunk + kColumns, kColumns>;

  void squeeze() {
    const Eigen::HouseholderQR<Rows> qr(rows_.topRows(filled_));
    const Triangle triangle =
        qr.matrixQR().template topRows<kColumns>().template triangularView<Eigen::Upper>();
    rows_.template topRows<kColumns>() = triangle;
    filled_ = kColumns;
  }

  // The triangle of what came before is stacked on top of each chunk.
  Rows rows_;
  Eigen::Index filled_ = kColumns;
};

}  // namespace synchronizar
