#include "factors/range_block.h"

#include <Eigen/QR>
#include <algorithm>
#include <utility>

namespace synchronizar {
namespace {

// What a range's bending adds to the second derivative in height: the cost's slope in the distance, times
// that of the distance.
double bending(const Line& line, double slope) {
  const double level = 1.0 - line.direction.z() * line.direction.z();
  return line.distance > 0.0 ? slope * level / line.distance : 0.0;
}

}  // namespace

RangeBlock::RangeBlock(Points o_i, Points o_j, Column measured, Column sigma, Column late_odds)
    : o_i_(std::move(o_i)),
      o_j_(std::move(o_j)),
      measured_(std::move(measured)),
      sigma_(std::move(sigma)),
      late_odds_(std::move(late_odds)) {}

RangeBlock RangeBlock::with_late_odds(Column late_odds) const {
  RangeBlock out = *this;
  out.late_odds_ = std::move(late_odds);
  return out;
}

template <class Visit>
void RangeBlock::for_each_line(const UserPose& i, const UserPose& j, Visit visit) const {
  const CommonFromLocal common_from_i(i), common_from_j(j);
  for (Eigen::Index n = 0; n < size(); ++n) {
    visit(n, Line(common_from_i(o_i_.row(n)), common_from_j(o_j_.row(n))));
  }
}

Column RangeBlock::residuals(const UserPose& i, const UserPose& j) const {
  Column out(size());
  for_each_line(i, j, [&](Eigen::Index n, const Line& line) { out[n] = line.distance - measured_[n]; });
  return out;
}

double RangeBlock::cost(const UserPose& i, const UserPose& j, const Loss& loss) const {
  double sum = 0.0;
  std::visit(
      [&](const auto& kind) {
        for_each_line(i, j, [&](Eigen::Index n, const Line& line) {
          const double e = (line.distance - measured_[n]) / sigma_[n];
          sum += annealed(kind, loss.annealing, e, traits(n)).rho;
        });
      },
      loss.kind);
  return sum;
}

Column RangeBlock::height_profile(const UserPose& i, const UserPose& j, const LossKind& loss, double step,
                                  int zero, int most_ranges) const {
  const CommonFromLocal common_from_i(i), common_from_j(j);
  const double difference_now = i.frame_height - j.frame_height;
  const Eigen::Index n = std::min<Eigen::Index>(size(), most_ranges);
  Column out = Column::Zero(2 * zero + 1);
  std::visit(
      [&](const auto& kind) {
        for (Eigen::Index k = 0; k < n; ++k) {
          const Eigen::Index row = (2 * k + 1) * size() / (2 * n);
          const Vector3 between = common_from_i(o_i_.row(row)) - common_from_j(o_j_.row(row));
          const double level2 = between.head<2>().squaredNorm();
          for (int s = -zero; s <= zero; ++s) {
            const double z = between.z() - difference_now + s * step;
            const double e = (std::sqrt(level2 + z * z) - measured_[row]) / sigma_[row];
            out[s + zero] += kind(e, traits(row)).rho;
          }
        }
      },
      loss);
  return out * (static_cast<double>(size()) / static_cast<double>(n));
}

RangeBlock::SquareRoot RangeBlock::square_root(const UserPose& i, const UserPose& j, const Loss& loss) const {
  // Chunks keep the memory bounded; the triangle of what came before is stacked on top of each.
  constexpr Eigen::Index kChunk = 512;
  constexpr double kLeastCurvature = 0.1;  // of the weight
  using Triangle = Eigen::Matrix<double, kRows, kRows>;
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, kRows, Eigen::ColMajor, kChunk + kRows, kRows>;
  Triangle triangle = Triangle::Zero();
  Rows rows(kChunk + kRows, static_cast<Eigen::Index>(kRows));
  Eigen::Index filled = kRows;
  double bends = 0.0;
  rows.topRows<kRows>().setZero();
  const auto squeeze = [&] {
    const Eigen::HouseholderQR<Rows> qr(rows.topRows(filled));
    triangle = qr.matrixQR().topRows<kRows>().triangularView<Eigen::Upper>();
    rows.topRows<kRows>() = triangle;
    filled = kRows;
  };
  std::visit(
      [&](const auto& kind) {
        for_each_line(i, j, [&](Eigen::Index n, const Line& line) {
          const double e = (line.distance - measured_[n]) / sigma_[n];
          const LossValue value = annealed(kind, loss.annealing, e, traits(n));
          const double slope = value.weight * e;
          const double root = std::sqrt(std::max(value.curvature, kLeastCurvature * value.weight));
          if (root == 0.0) return;
          rows.row(filled).head<4>() = root / sigma_[n] * line.coordinates().transpose();
          rows(filled, 4) = slope / root;
          if (++filled == rows.rows()) squeeze();
          bends += bending(line, slope / sigma_[n]);
        });
      },
      loss.kind);
  if (bends > 0.0) {
    rows.row(filled).setZero();
    rows(filled++, 2) = std::sqrt(bends);
  }
  squeeze();
  SquareRoot out;
  out.leftCols<kUserColumns>() = triangle.leftCols<4>() * line_to_user(i);
  out.middleCols<kUserColumns>(kUserColumns) = -triangle.leftCols<4>() * line_to_user(j);
  out.rightCols<1>() = triangle.col(4);
  return out;
}

double RangeBlock::height_bending(const UserPose& i, const UserPose& j, const Loss& loss) const {
  double sum = 0.0;
  std::visit(
      [&](const auto& kind) {
        for_each_line(i, j, [&](Eigen::Index n, const Line& line) {
          const double e = (line.distance - measured_[n]) / sigma_[n];
          const double slope = annealed(kind, loss.annealing, e, traits(n)).weight * e;
          sum += bending(line, slope / sigma_[n]);
        });
      },
      loss.kind);
  return sum;
}

Column RangeBlock::weights(const UserPose& i, const UserPose& j, const Loss& loss) const {
  Column out(size());
  std::visit(
      [&](const auto& kind) {
        for_each_line(i, j, [&](Eigen::Index n, const Line& line) {
          const double e = (line.distance - measured_[n]) / sigma_[n];
          out[n] = annealed(kind, loss.annealing, e, traits(n)).weight;
        });
      },
      loss.kind);
  return out;
}

Column RangeBlock::honest(const UserPose& i, const UserPose& j, const Late& late) const {
  Column out(size());
  for_each_line(i, j, [&](Eigen::Index n, const Line& line) {
    out[n] = late.honest((line.distance - measured_[n]) / sigma_[n], traits(n));
  });
  return out;
}

}  // namespace synchronizar
