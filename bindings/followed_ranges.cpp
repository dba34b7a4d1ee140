// Ranges as a window of slots keeps them.
#include "factors/followed_ranges.h"

#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <tuple>
#include <utility>
#include <vector>

#include "bindings/bindings.h"
#include "bindings/checks.h"
#include "factors/by_serial.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

namespace {

FollowedColumns followed_columns(const FollowedRanges& ranges, const std::array<int, 6>& columns) {
  for (size_t k = 0; k < 6; ++k) {
    require(columns[k] >= 0 && columns[k] + (k < 4 ? 1 : 9) <= ranges.cols(),
            "the ranges have no such column");
  }
  return {columns[0], columns[1], columns[2], columns[3], columns[4], columns[5]};
}

WeighedColumns weighed_columns(const FollowedRanges& ranges, const std::array<int, 5>& columns) {
  for (const int column : columns) {
    require(column >= 0 && column < ranges.cols(), "the ranges have no such column");
  }
  return {columns[0], columns[1], columns[2], columns[3], columns[4]};
}

void check_followed(const FollowedRanges& ranges, const FollowedColumns& of,
                    const Eigen::Ref<const FollowedStates>& states, int users, int first) {
  require(users > 0 && states.rows() % users == 0, "states must be those of all users, slot by slot");
  const double slots = static_cast<double>(states.rows() / users);
  for (Eigen::Index k = 0; k < ranges.rows(); ++k) {
    const double i = ranges(k, of.user_i), j = ranges(k, of.user_j), slot = ranges(k, of.slot) - first;
    require(i >= 0.0 && i < users && j >= 0.0 && j < users, "a range names a user that is not there");
    require(slot >= 0.0 && slot < slots, "a range is of a slot that is not there");
  }
}

}  // namespace

void bind_followed_ranges(nb::module_& m) {
  m.def(
      "followed_apart",
      [](const FollowedRanges& ranges, const std::array<int, 6>& columns,
         const Eigen::Ref<const FollowedStates>& states, int users, int first) {
        const FollowedColumns of = followed_columns(ranges, columns);
        check_followed(ranges, of, states, users, first);
        const FollowedApart found = followed_apart(ranges, of, states, users, first);
        return std::tuple(found.away, found.bias, found.residual);
      },
      "ranges"_a, "columns"_a, "states"_a, "users"_a, "first"_a);

  m.def(
      "followed_slot",
      [](const FollowedRanges& ranges, const std::array<int, 6>& columns, const std::array<int, 5>& weighed) {
        const FollowedColumns of = followed_columns(ranges, columns);
        const WeighedColumns by = weighed_columns(ranges, weighed);
        require(ranges.rows() > 0 && ranges.allFinite(), "at least one range is needed, and finite numbers");
        require(std::min(ranges.col(of.user_i).minCoeff(), ranges.col(of.user_j).minCoeff()) >= 0.0,
                "a range names a user that is not there");
        require((ranges.col(of.user_i).array() != ranges.col(of.user_j).array()).all(),
                "a range is between two users");
        check_nlos_odds(ranges.col(by.nlos_odds), ranges.rows());
        check_range_weight(ranges.col(by.range_weight), ranges.rows());
        require(ranges.col(by.sigma).minCoeff() > 0.0, "sigma must be positive");
        FollowedSlot found = followed_slot(ranges, of, by);
        return std::pair(std::move(found.users), std::move(found.ranges));
      },
      "ranges"_a, "columns"_a, "weighed"_a);

  m.def(
      "judged_bursts",
      [](const FollowedRanges& ranges, const std::array<int, 6>& columns, const std::array<int, 5>& weighed,
         const Eigen::Ref<const FollowedStates>& states, int users, int first, int since,
         const Eigen::Ref<const Matrix>& sizes, const NlosMixture& loss, const Bursts& bursts, double surest,
         double changed) {
        const FollowedColumns of = followed_columns(ranges, columns);
        const WeighedColumns by = weighed_columns(ranges, weighed);
        check_followed(ranges, of, states, users, first);
        require(sizes.rows() == users && sizes.cols() == users && (sizes.array() > 0.0).all(),
                "sizes must be (users, users) and positive");
        if (ranges.rows() > 0) {
          require(ranges.col(by.sigma).minCoeff() > 0.0, "sigma must be positive");
          require(std::min(ranges.col(by.prior_odds).minCoeff(), ranges.col(by.nlos_odds).minCoeff()) >= 0.0,
                  "odds must not be negative");
        }
        const JudgedRanges found = judged_bursts(ranges, of, by, states, users, first, since, sizes,
                                                 {loss, bursts, surest, changed});
        return std::tuple(found.slots, found.rows, found.nlos_odds);
      },
      "ranges"_a, "columns"_a, "weighed"_a, "states"_a, "users"_a, "first"_a, "since"_a, "sizes"_a, "loss"_a,
      "bursts"_a, "surest"_a, "changed"_a);

  m.def(
      "rows_by_serial",
      [](const Numbers& serial, const std::vector<std::pair<Numbers, Matrix>>& tables,
         const Column& unknown) {
        std::vector<SerialRows> of_each;
        of_each.reserve(tables.size());
        for (const auto& [known, values] : tables) {
          require(values.rows() == known.size() && values.cols() == unknown.size(),
                  "a table must have a row a range, and as many columns as unknown");
          of_each.push_back({known, values});
        }
        const FoundRows found = rows_by_serial(serial, of_each, unknown);
        return std::pair(found.known, found.values);
      },
      "serial"_a, "tables"_a, "unknown"_a);
}

}  // namespace synchronizar
