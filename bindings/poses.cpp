// Poses between those of a table.
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "bindings/bindings.h"
#include "bindings/checks.h"
#include "factors/pose_table.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

namespace {

using PoseArray = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void check_pose_columns(const PoseTable& table, const std::array<int, 3>& columns) {
  constexpr std::array<int, 3> kWidths{1, 3, 4};  // stamp, position, attitude
  for (size_t k = 0; k < 3; ++k) {
    require(columns[k] >= 0 && columns[k] + kWidths[k] <= table.cols(), "the poses have no such column");
  }
}

}  // namespace

void bind_poses(nb::module_& m) {
  m.def(
      "poses_at",
      [](const PoseTable& table, const std::array<int, 3>& columns, const Column& t, double longest) {
        require(table.rows() > 0, "at least one pose is needed");
        check_pose_columns(table, columns);
        const PosesAt found = poses_at(table, {columns[0], columns[1], columns[2]}, t, longest);
        return std::tuple(found.position, found.attitude, found.valid);
      },
      "table"_a, "columns"_a, "t"_a, "longest"_a);

  m.def(
      "read_ranges",
      [](const std::vector<std::optional<PoseArray>>& tables, const std::array<int, 3>& columns,
         const Column& clocks, const Column& t,
         const Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor>& users, const Points& levers,
         const Eigen::Array<bool, Eigen::Dynamic, 1>& wanted, double reach, double longest) {
        const auto n = t.size();
        require(users.rows() == n && levers.rows() == 2 * n && wanted.size() == n,
                "users must be (n, 2), levers (2 n, 3), wanted (n,)");
        require(static_cast<size_t>(clocks.size()) == tables.size(), "clocks must be one a table");
        require(n == 0 || (users.minCoeff() >= 0 && static_cast<size_t>(users.maxCoeff()) < tables.size()),
                "a range names a user that is not there");
        std::vector<PoseTable> known;
        known.reserve(tables.size());
        std::vector<RangingDevice> devices;
        devices.reserve(tables.size());
        for (size_t u = 0; u < tables.size(); ++u) {
          const PoseTable* table = nullptr;
          if (tables[u]) {
            const PoseArray& poses = *tables[u];
            known.emplace_back(Eigen::Map<const Matrix>(poses.data(),
                                                        static_cast<Eigen::Index>(poses.shape(0)),
                                                        static_cast<Eigen::Index>(poses.shape(1))));
            table = &known.back();
            check_pose_columns(*table, columns);
          }
          devices.push_back({table, clocks[static_cast<Eigen::Index>(u)]});
        }
        const RangesRead found = read_ranges(devices, {columns[0], columns[1], columns[2]}, t, users, levers,
                                             wanted, reach, longest);
        return std::pair(found.ends, found.valid);
      },
      "tables"_a, "columns"_a, "clocks"_a, "t"_a, "users"_a, "levers"_a, "wanted"_a, "reach"_a, "longest"_a);
}

}  // namespace synchronizar
