#include "factors/innovation_tests.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "factors/common_shift.h"

namespace synchronizar {
namespace {

constexpr double kClipped = 3.0;  // sigmas: in scores, which know nothing of NLOS, no range counts for more
constexpr int kLookedAt = 2;      // groups whose shifts are fitted
constexpr double kLongAlone =
    0.5;  // of its gain counts where a shift stays, and no pair's ranges are too short
constexpr double kNearest = 0.1;  // m: nearer, a direction is not known
constexpr std::size_t kMostInPairs =
    8;  // users, for each two to be a group: of more, chains of fits make them

using Group = std::vector<int>;

struct Pair {
  int i, j;
  Eigen::Index first, end;  // among the rows in question
  double weight;            // of each of its ranges
  Eigen::Vector4d score;    // in space, and upwards whoever of the two it is
  Eigen::Matrix4d normal;
  bool is_short;
};

double median(std::vector<double> of) {
  const auto middle = of.begin() + static_cast<std::ptrdiff_t>(of.size() / 2);
  std::nth_element(of.begin(), middle, of.end());
  if (of.size() % 2 == 1) return *middle;
  return 0.5 * (*middle + *std::max_element(of.begin(), middle));
}

// Groups of `users` (sorted) that may be off together; of a group and all others but one.
std::vector<Group> groups_of(const std::vector<int>& users) {
  std::vector<Group> out;
  const auto add = [&](const Group& group) {
    Group others;
    std::set_difference(users.begin(), users.end(), group.begin(), group.end(), std::back_inserter(others));
    if (!others.empty() && std::find(out.begin(), out.end(), others) == out.end()) out.push_back(group);
  };
  for (const int user : users) add({user});
  if (users.size() > kMostInPairs) return out;
  for (std::size_t a = 0; a < users.size(); ++a) {
    for (std::size_t b = a + 1; b < users.size(); ++b) add({users[a], users[b]});
  }
  return out;
}

// 1 if only i is of a group, -1 if only j is, 0 else.
int side_of(const Pair& pair, const Group& group) {
  const auto has = [&](int user) {
    return std::find(group.begin(), group.end(), user) != group.end() ? 1 : 0;
  };
  return has(pair.i) - has(pair.j);
}

// What is left of a stretch, by pair and time.
Matrix part_of(const Innovations& rows, const Stretch& stretch) {
  std::vector<Eigen::Index> order;
  for (Eigen::Index n = 0; n < rows.rows(); ++n) {
    if (rows(n, kStamp) > stretch.since) order.push_back(n);
  }
  std::sort(order.begin(), order.end(), [&](Eigen::Index a, Eigen::Index b) {
    for (const auto column : {kUserI, kUserJ, kStamp}) {
      if (rows(a, column) != rows(b, column)) return rows(a, column) < rows(b, column);
    }
    return a < b;
  });
  Matrix out(static_cast<Eigen::Index>(order.size()), kInnovationColumns);
  for (std::size_t n = 0; n < order.size(); ++n) {
    out.row(static_cast<Eigen::Index>(n)) = rows.row(order[n]).head<kInnovationColumns>();
  }
  return out;
}

Column shares_of(const Matrix& part, const Stretch& stretch) {
  if (!stretch.grows) return Column::Ones(part.rows());
  const double length = stretch.until - stretch.since;
  return ((part.col(kStamp).array() - stretch.since) / length).max(0.0).min(1.0);
}

std::vector<Pair> pairs_of(const Matrix& part, const Column& share) {
  std::vector<Pair> out;
  for (Eigen::Index n = 0; n < part.rows(); ++n) {
    const int i = static_cast<int>(part(n, kUserI)), j = static_cast<int>(part(n, kUserJ));
    if (out.empty() || out.back().i != i || out.back().j != j) {
      out.push_back({i, j, n, n, 0.0, Eigen::Vector4d::Zero(), Eigen::Matrix4d::Zero(), false});
    }
    out.back().end = n + 1;
    out.back().weight += part(n, kWeight);
  }
  std::vector<double> weights;
  for (Pair& pair : out) {
    pair.weight /= static_cast<double>(pair.end - pair.first);
    weights.push_back(pair.weight);
  }
  // Ranges that misfit are worth little: no excuse for those who move.
  const double least = out.empty() ? 0.0 : median(std::move(weights));
  for (Pair& pair : out) {
    pair.weight = std::max(pair.weight, least);
    double sum = 0.0;
    for (Eigen::Index n = pair.first; n < pair.end; ++n) {
      const Eigen::Vector3d away = part.row(n).segment<3>(kAway).transpose();
      const double apart = away.norm(), sigma = part(n, kSigma);
      const double e = std::clamp((apart - part(n, kMeasured)) / sigma, -kClipped, kClipped);
      Eigen::Vector4d slope;
      slope << away / std::max(apart, kNearest), 1.0;
      slope *= share[n] / sigma;
      sum += e;
      pair.score += pair.weight * e * slope;
      pair.normal += pair.weight * slope * slope.transpose();
    }
    pair.is_short = sum > static_cast<double>(pair.end - pair.first);
  }
  return out;
}

// Log likelihood that a shift of a group gains, by the scores of its pairs.
double score_of(const Group& group, const std::vector<Pair>& pairs, const ShiftLimits& limits) {
  Eigen::Vector4d score = Eigen::Vector4d::Zero();
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  double count = 0.0;
  for (const Pair& pair : pairs) {
    const int side = side_of(pair, group);
    if (side == 0) continue;
    count += static_cast<double>(pair.end - pair.first);
    // One who goes up or down gets away from all that are about it, on whichever side of the pair it is.
    const Eigen::Vector4d sides(side, side, side, 1.0);
    score += sides.cwiseProduct(pair.score);
    normal += sides.asDiagonal() * pair.normal * sides.asDiagonal();
  }
  if (count < limits.fewest) return 0.0;
  normal.diagonal().array() += 1.0 / (limits.sigma * limits.sigma);
  return 0.5 * score.dot(normal.ldlt().solve(score));
}

GroupShift fitted(const Group& group, const std::vector<Pair>& pairs, const Matrix& part, const Column& share,
                  const Stretch& stretch, const ShiftLimits& limits, const NlosMixture& loss,
                  const Bursts& bursts) {
  Eigen::Index n = 0, count = 0;
  bool is_short = false;
  for (const Pair& pair : pairs) {
    if (side_of(pair, group) == 0) continue;
    n += pair.end - pair.first;
    ++count;
    is_short = is_short || pair.is_short;
  }
  ShiftedRanges ranges{Eigen::VectorXi(count + 1),
                       Column(n),
                       Points(n, 3),
                       Column(n),
                       Column(n),
                       Column(n),
                       Column(n),
                       Column(count)};
  Eigen::Index at = 0, of = 0;
  for (const Pair& pair : pairs) {
    const int side = side_of(pair, group);
    if (side == 0) continue;
    const Eigen::Index size = pair.end - pair.first;
    const auto rows = part.middleRows(pair.first, size);
    ranges.bounds[of] = static_cast<int>(at);
    ranges.weight[of++] = pair.weight;
    ranges.t.segment(at, size) = rows.col(kStamp);
    ranges.away.middleRows(at, size) = side * rows.middleCols<3>(kAway);
    ranges.distance.segment(at, size) = rows.col(kMeasured);
    ranges.sigma.segment(at, size) = rows.col(kSigma);
    ranges.nlos_odds.segment(at, size) = rows.col(kOdds);
    ranges.share.segment(at, size) = share.segment(pair.first, size);
    at += size;
  }
  ranges.bounds[of] = static_cast<int>(at);
  const Eigen::Vector3d precision = Eigen::Vector3d::Constant(1.0 / (limits.sigma * limits.sigma));
  Points starts = Points::Zero(3, 3);
  starts(1, 2) = 1.0;
  starts(2, 2) = -1.0;
  const CommonShift found = common_shift(ranges, precision, starts, loss, bursts);
  // A body in between makes all of somebody's ranges too long, for a moment, by lengths that stay.
  const double sure = stretch.grows || is_short ? 1.0 : kLongAlone;
  return {group, found.shift, sure * found.gain};
}

}  // namespace

std::vector<GroupShift> shifted_groups(const Innovations& rows, const Stretch& stretch,
                                       const ShiftLimits& limits, const NlosMixture& loss,
                                       const Bursts& bursts) {
  const Matrix part = part_of(rows, stretch);
  if (static_cast<double>(part.rows()) < limits.fewest) return {};
  const Column share = shares_of(part, stretch);
  const std::vector<Pair> pairs = pairs_of(part, share);
  std::vector<int> users;
  for (const Pair& pair : pairs) {
    users.push_back(pair.i);
    users.push_back(pair.j);
  }
  std::sort(users.begin(), users.end());
  users.erase(std::unique(users.begin(), users.end()), users.end());
  std::vector<std::pair<double, Group>> likely;
  for (Group& group : groups_of(users)) {
    const double score = score_of(group, pairs, limits);
    if (score >= limits.looked_at) likely.emplace_back(score, std::move(group));
  }
  std::sort(likely.begin(), likely.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  if (likely.size() > kLookedAt) likely.resize(kLookedAt);
  std::vector<GroupShift> out;
  out.reserve(likely.size());
  for (const auto& [score, group] : likely) {
    out.push_back(fitted(group, pairs, part, share, stretch, limits, loss, bursts));
  }
  std::sort(out.begin(), out.end(), [](const auto& a, const auto& b) { return a.gain > b.gain; });
  return out;
}

std::optional<Misfit> worst_misfit(const Innovations& rows, double since, const MisfitLimits& limits) {
  struct Count {
    double all = 0.0, too_short = 0.0, off = 0.0;
  };
  std::vector<Count> of_user;
  double ranges = 0.0;
  for (Eigen::Index n = 0; n < rows.rows(); ++n) {
    if (rows(n, kStamp) <= since) continue;
    ++ranges;
    const double e = rows(n, kWhitened);
    for (const auto end : {kUserI, kUserJ}) {
      const auto user = static_cast<std::size_t>(rows(n, end));
      if (user >= of_user.size()) of_user.resize(user + 1);
      ++of_user[user].all;
      if (e > limits.sigmas) ++of_user[user].too_short;
      if (std::abs(e) > limits.sigmas) ++of_user[user].off;
    }
  }
  if (ranges < limits.fewest) return std::nullopt;
  const double allowed = limits.short_share;
  double most = 1.0;
  std::optional<Misfit> out;
  for (std::size_t user = 0; user < of_user.size(); ++user) {
    const Count& count = of_user[user];
    if (count.all < limits.fewest) continue;
    const double limit = allowed + 3.0 * std::sqrt(allowed * (1.0 - allowed) / count.all);
    double excess = count.too_short / count.all / limit;
    if (limits.lasting && count.all >= limits.many) {
      excess = std::max(excess, count.off / count.all / limits.off_share);
    }
    if (excess > most) {
      most = excess;
      out = {static_cast<int>(user), std::max(count.too_short, count.off) / count.all};
    }
  }
  return out;
}

}  // namespace synchronizar
