#include "factors/followed_ranges.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <utility>

#include "factors/mixture_terms.h"

namespace synchronizar {
namespace {

// Rows by what stands in some columns, equal ones in the order of the table.
template <std::size_t kColumns>
void sort_rows(std::vector<Eigen::Index>& rows, const FollowedRanges& ranges,
               const std::array<Eigen::Index, kColumns>& by) {
  std::sort(rows.begin(), rows.end(), [&](Eigen::Index a, Eigen::Index b) {
    for (const Eigen::Index column : by) {
      if (ranges(a, column) != ranges(b, column)) return ranges(a, column) < ranges(b, column);
    }
    return a < b;
  });
}

Column column_of(const FollowedRanges& ranges, const std::vector<Eigen::Index>& rows, Eigen::Index column) {
  Column out(static_cast<Eigen::Index>(rows.size()));
  for (std::size_t n = 0; n < rows.size(); ++n) out[static_cast<Eigen::Index>(n)] = ranges(rows[n], column);
  return out;
}

Points points_of(const FollowedRanges& ranges, const std::vector<Eigen::Index>& rows, Eigen::Index first) {
  Points out(static_cast<Eigen::Index>(rows.size()), 3);
  for (std::size_t n = 0; n < rows.size(); ++n) {
    out.row(static_cast<Eigen::Index>(n)) = ranges.row(rows[n]).segment<3>(first);
  }
  return out;
}

}  // namespace

FollowedApart followed_apart(const FollowedRanges& ranges, const FollowedColumns& columns,
                             const Eigen::Ref<const FollowedStates>& states, Eigen::Index users,
                             Eigen::Index first) {
  // Of each state: cosine and sine of yaw, scale.
  Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> turned(states.rows(), 3);
  turned.col(0) = states.col(2).array().cos();
  turned.col(1) = states.col(2).array().sin();
  turned.col(2) = states.col(4).array().exp();
  FollowedApart out{Points(ranges.rows(), 3), Column(ranges.rows()), Column(ranges.rows())};
  for (Eigen::Index n = 0; n < ranges.rows(); ++n) {
    const auto row = ranges.row(n);
    const Eigen::Index begin = (static_cast<Eigen::Index>(row[columns.slot]) - first) * users;
    const auto antenna = [&](Eigen::Index at, Eigen::Index end) {
      const auto state = states.row(at);
      const Vector3 arm = turned(at, 2) * row.segment<3>(end).transpose() +
                          row.segment<3>(end + 3).transpose() +
                          state[6] * row.segment<3>(end + 6).transpose();
      const double c = turned(at, 0), s = turned(at, 1);
      return Vector3(state[0] + c * arm.x() - s * arm.y(), state[1] + s * arm.x() + c * arm.y(),
                     state[3] + arm.z());
    };
    const Eigen::Index i = begin + static_cast<Eigen::Index>(row[columns.user_i]);
    const Eigen::Index j = begin + static_cast<Eigen::Index>(row[columns.user_j]);
    const Vector3 away = antenna(i, columns.end_i) - antenna(j, columns.end_j);
    out.away.row(n) = away.transpose();
    out.bias[n] = states(i, 5) + states(j, 5);
    out.residual[n] = away.norm() + out.bias[n] - row[columns.measured];
  }
  return out;
}

FollowedSlot followed_slot(const FollowedRanges& ranges, const FollowedColumns& columns,
                           const WeighedColumns& weighed) {
  const Eigen::Index n = ranges.rows();
  std::vector<Eigen::Index> rows(static_cast<std::size_t>(n));
  for (Eigen::Index row = 0; row < n; ++row) rows[static_cast<std::size_t>(row)] = row;
  sort_rows(rows, ranges, std::array{columns.user_i, columns.user_j});
  std::set<int> present;
  for (Eigen::Index row = 0; row < n; ++row) {
    present.insert(static_cast<int>(ranges(row, columns.user_i)));
    present.insert(static_cast<int>(ranges(row, columns.user_j)));
  }
  std::vector<int> users(present.begin(), present.end());
  const auto places = [&](Eigen::Index column) {
    Numbers out(n);
    for (Eigen::Index row = 0; row < n; ++row) {
      const auto user = static_cast<int>(ranges(rows[static_cast<std::size_t>(row)], column));
      out[row] = static_cast<int>(std::lower_bound(users.begin(), users.end(), user) - users.begin());
    }
    return out;
  };
  const auto antennas = [&](Eigen::Index end) {
    return Antennas{points_of(ranges, rows, end), points_of(ranges, rows, end + 3),
                    points_of(ranges, rows, end + 6)};
  };
  RangeSlot slot(static_cast<int>(users.size()), places(columns.user_i), places(columns.user_j),
                 antennas(columns.end_i), antennas(columns.end_j), column_of(ranges, rows, columns.measured),
                 column_of(ranges, rows, weighed.sigma), column_of(ranges, rows, weighed.nlos_odds),
                 column_of(ranges, rows, weighed.range_weight));
  return {std::move(users), std::move(slot)};
}

JudgedRanges judged_bursts(const FollowedRanges& ranges, const FollowedColumns& columns,
                           const WeighedColumns& weighed, const Eigen::Ref<const FollowedStates>& states,
                           Eigen::Index users, Eigen::Index first, Eigen::Index since,
                           const Eigen::Ref<const Matrix>& sizes, const BurstJudgement& judgement) {
  std::vector<Eigen::Index> rows;
  for (Eigen::Index row = 0; row < ranges.rows(); ++row) {
    if (ranges(row, columns.slot) >= static_cast<double>(since)) rows.push_back(row);
  }
  sort_rows(rows, ranges, std::array{columns.user_i, columns.user_j, weighed.stamp});
  const auto n = static_cast<Eigen::Index>(rows.size());
  Matrix part(n, ranges.cols());
  Column size(n);
  std::vector<int> bounds{0};
  for (Eigen::Index row = 0; row < n; ++row) {
    part.row(row) = ranges.row(rows[static_cast<std::size_t>(row)]);
    const double i = part(row, columns.user_i), j = part(row, columns.user_j);
    size[row] = sizes(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
    if (row > 0 && (part(row - 1, columns.user_i) != i || part(row - 1, columns.user_j) != j)) {
      bounds.push_back(static_cast<int>(row));
    }
  }
  bounds.push_back(static_cast<int>(n));
  const Column sigma = part.col(weighed.sigma), prior = part.col(weighed.prior_odds);
  const Column whitened = followed_apart(part, columns, states, users, first).residual.cwiseQuotient(sigma);
  const Eigen::Map<const Numbers> pairs(bounds.data(), static_cast<Eigen::Index>(bounds.size()));
  Column odds = burst_nlos_odds(pairs, part.col(weighed.stamp), whitened.cwiseQuotient(size),
                                sigma.cwiseProduct(size), prior, judgement.loss, judgement.bursts)
                    .nlos_odds;
  // The loss has the model's sigma: at these residuals it is to say what the chain says.
  for (Eigen::Index row = 0; row < n; ++row) {
    const double early = std::min(whitened[row], 0.0);
    const double narrower = 0.5 * early * early * (1.0 / (size[row] * size[row]) - 1.0);
    odds[row] = std::min(odds[row] * size[row] * std::exp(std::min(narrower, judgement.surest)),
                         std::exp(judgement.surest));
  }
  const Column inlier = mixture_terms(whitened, sigma, odds, judgement.loss).inlier_probability;
  const Column before =
      mixture_terms(whitened, sigma, part.col(weighed.nlos_odds), judgement.loss).inlier_probability;
  std::set<int> slots;
  for (Eigen::Index row = 0; row < n; ++row) {
    if (std::abs(inlier[row] - before[row]) > judgement.changed) {
      slots.insert(static_cast<int>(part(row, columns.slot)));
    }
  }
  std::vector<Eigen::Index> taken;  // the others keep what they were put with
  for (Eigen::Index row = 0; row < n; ++row) {
    if (slots.count(static_cast<int>(part(row, columns.slot))) > 0) taken.push_back(row);
  }
  JudgedRanges out{{slots.begin(), slots.end()},
                   Numbers(static_cast<Eigen::Index>(taken.size())),
                   Column(static_cast<Eigen::Index>(taken.size()))};
  for (std::size_t k = 0; k < taken.size(); ++k) {
    out.rows[static_cast<Eigen::Index>(k)] = static_cast<int>(rows[static_cast<std::size_t>(taken[k])]);
    out.nlos_odds[static_cast<Eigen::Index>(k)] = odds[taken[k]];
  }
  return out;
}

}  // namespace synchronizar
