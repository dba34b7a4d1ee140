#include "factors/walk_ranges.h"

#include <array>
#include <utility>
#include <variant>

namespace synchronizar {

namespace {

constexpr int kBias = 5;                // column of the first device's bias in a pair's squares
constexpr int kLast = 2 * kOwnColumns;  // column of the residuals there

std::vector<DeviceAtKeyframe> devices(const WalkLayout& layout, const WalkStates& states,
                                      const Column& assumed_clock) {
  std::vector<DeviceAtKeyframe> out;
  out.reserve(static_cast<size_t>(states.places.rows()));
  for (Eigen::Index n = 0; n < states.places.rows(); ++n) {
    const auto p = states.places.row(n);
    const auto c = states.calibration.row(layout.user(n));
    out.emplace_back(UserPose{p[0], p[1], p[3], p[2]},
                     Calibration{c[0], c[1], c[2] - assumed_clock[layout.user(n)]});
  }
  return out;
}

double lasting_error(Eigen::Index range, const Walks& walks, const WalkStates& states) {
  return walks.lasting.size() == 0 ? 0.0 : states.lasting[walks.lasting[range]];
}

// The squares of a run of ranges between two keyframes, laid where their variables stand; `lasting` is the
// error that all of the run have, or -1.
void add_squares(WalkSystem& system, const WalkLayout& layout, const WalkStates& states, int key_i, int key_j,
                 int lasting, PairSquares squares) {
  using Columns = std::array<std::pair<Where, int>, 2>;
  const Columns places{{{layout.keyframe(key_i), 0}, {layout.keyframe(key_j), kOwnColumns}}};
  // A keyframe that is fixed moves in height by its device's scale.
  for (const auto& [first, key] : {std::pair(0, key_i), std::pair(kOwnColumns, key_j)}) {
    const double by_scale = layout.height_by_scale(key, states);
    if (by_scale == 0.0) continue;
    squares.col(first + 4) += by_scale * squares.col(first + 2);
    squares.row(first + 4) += by_scale * squares.row(first + 2);
  }
  const Columns of_devices{
      {{layout.device(layout.user(key_i)), 4}, {layout.device(layout.user(key_j)), kOwnColumns + 4}}};
  for (const auto& [a, row] : of_devices) {
    system.add(a, a, squares.block<3, 3>(row, row));
    system.add_gradient(a, squares.block<3, 1>(row, kLast));
    for (const auto& [b, column] : places) system.add(a, b, squares.block<3, 4>(row, column));
  }
  system.add(of_devices[0].first, of_devices[1].first, squares.block<3, 3>(4, kOwnColumns + 4));
  for (const auto& [a, row] : places) {
    system.add(a, a, squares.block<4, 4>(row, row));
    system.add_gradient(a, squares.block<4, 1>(row, kLast));
  }
  system.add(places[0].first, places[1].first, squares.block<4, 4>(0, kOwnColumns));
  if (lasting < 0) return;
  // A lasting error makes a range longer just as a bias does.
  const Where& at = layout.lasting(lasting);
  system.add(at, at, squares.block<1, 1>(kBias, kBias));
  system.add_gradient(at, squares.block<1, 1>(kBias, kLast));
  for (const auto& [a, row] : places) system.add(at, a, squares.block<1, 4>(kBias, row));
  for (const auto& [a, row] : of_devices) system.add(at, a, squares.block<1, 3>(kBias, row));
}

}  // namespace

Column range_residuals(const WalkLayout& layout, const WalkStates& states, const Column& assumed_clock) {
  const Walks& walks = layout.walks();
  const auto at = devices(layout, states, assumed_clock);
  Column out(walks.measured.size());
  for (Eigen::Index n = 0; n < out.size(); ++n) {
    const DeviceAtKeyframe& i = at[static_cast<size_t>(walks.keyframe_i[n])];
    const DeviceAtKeyframe& j = at[static_cast<size_t>(walks.keyframe_j[n])];
    const Vector3 between = i.place() + i.arm(walks.i.at(n)) - j.place() - j.arm(walks.j.at(n));
    out[n] = between.norm() + i.range_bias() + j.range_bias() + lasting_error(n, walks, states) -
             walks.measured[n];
  }
  return out;
}

void add_bend(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
              const HeightBend& bend) {
  const auto [i, by_i] = layout.height(bend.key_i, states);
  const auto [j, by_j] = layout.height(bend.key_j, states);
  system.add(i, i, OneByOne(bend.information * by_i * by_i));
  system.add(j, j, OneByOne(bend.information * by_j * by_j));
  system.add(i, j, OneByOne(-bend.information * by_i * by_j));
}

void add_ranges(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
                const WalkNoise& noise, const Loss& loss, const Column* height_curvature) {
  const Walks& walks = layout.walks();
  const auto at = devices(layout, states, noise.assumed_clock);
  const Eigen::Index n = walks.measured.size();
  RowSquares sum;
  const auto add_all = [&](const auto& kind) {
    for (Eigen::Index begin = 0, end = 0; begin < n; begin = end) {
      // A run of ranges between the same two keyframes, with the same lasting error.
      const int lasting = walks.lasting.size() == 0 ? -1 : walks.lasting[begin];
      const double longer = lasting_error(begin, walks, states);
      const int key_i = walks.keyframe_i[begin], key_j = walks.keyframe_j[begin];
      const DeviceAtKeyframe &i = at[static_cast<size_t>(key_i)], &j = at[static_cast<size_t>(key_j)];
      sum.clear();
      double height_information = 0.0, replaced = 0.0;
      for (; end < n && walks.keyframe_i[end] == key_i && walks.keyframe_j[end] == key_j &&
             (lasting < 0 || walks.lasting[end] == lasting);
           ++end) {
        const RangeTerms terms = add_range(sum, kind, loss.annealing, i, j, walks.i.at(end), walks.j.at(end),
                                           walks.measured[end] - longer,
                                           {walks.sigma[end], noise.nlos_odds[end]}, noise.range_weight[end]);
        system.cost += terms.loss;
        height_information += terms.height_curvature;
        if (height_curvature != nullptr) replaced += (*height_curvature)[end];
      }
      if (height_curvature != nullptr) height_information = replaced;
      add_squares(system, layout, states, key_i, key_j, lasting, sum.of_columns());
      const HeightBend bend{key_i, key_j, height_information};
      if (height_information > 0.0) {
        add_bend(system, layout, states, bend);
      } else if (height_information < 0.0) {
        system.downwards.push_back(bend);
      }
    }
  };
  std::visit(add_all, loss.kind);
}

}  // namespace synchronizar
