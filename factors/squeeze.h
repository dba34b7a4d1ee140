// Reduces any number of rows [A b] to a triangle with the same A' A and A' b, by a QR in chunks: memory is
// bounded and no normal equations are formed.
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

  // The next row, set to zero, for the caller to fill in.
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

  // The triangle of all earlier rows, on top of the current chunk.
  Rows rows_;
  Eigen::Index filled_ = kColumns;
};

}  // namespace synchronizar
