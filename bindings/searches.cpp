// Searches over a frame's place and over heights.
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <tuple>
#include <utility>
#include <vector>

#include "bindings/bindings.h"
#include "bindings/checks.h"
#include "bindings/heights.h"
#include "factors/height_search.h"
#include "factors/placement_search.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

void bind_searches(nb::module_& m) {
  m.def(
      "search_heights",
      [](const Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>& frames, const Column& sigma,
         const Eigen::Array<bool, Eigen::Dynamic, 1>& free,
         const std::vector<std::tuple<int, int, const RangeBlock*>>& pairs, const LossKind& loss,
         double most_above, int most) {
        const auto n = frames.rows();
        require(sigma.size() == n && (sigma.array() > 0.0).all(), "sigma must be (k,) and positive");
        require(free.size() == n, "free must be (k,)");
        require(frames.allFinite() && sigma.allFinite(), "frames and sigmas must be finite");
        require(most > 0, "most must be positive");
        std::vector<HeightUser> users;
        for (Eigen::Index u = 0; u < n; ++u) {
          users.push_back(
              {{frames(u, 0), frames(u, 1), frames(u, 3), frames(u, 2)}, sigma[u], free[u], false});
        }
        std::vector<HeightPair> all;
        for (const auto& [i, j, block] : pairs) {
          require(0 <= i && i < n && 0 <= j && j < n && block != nullptr,
                  "a pair names a user that is not there");
          all.push_back({i, j, block});
          users[static_cast<size_t>(i)].present = users[static_cast<size_t>(j)].present = true;
        }
        return heights_and_costs(search_heights(users, all, loss, most_above, most));
      },
      "frames"_a, "sigma"_a, "free"_a, "pairs"_a, "loss"_a, "most_above"_a, "most"_a);

  m.def(
      "search_placements",
      [](const Points& known, const Points& own, const Column& measured, const Column& sigma,
         const Column& nlos_odds, double height_sigma, bool has_yaw, const NlosMixture& loss, double apart,
         int most_candidates, int most_ranges, double most_cost_above) {
        check_ranges(known, own, measured, sigma, nlos_odds);
        require(height_sigma > 0.0, "height_sigma must be positive");
        require(apart >= 0.0 && most_cost_above >= 0.0, "apart and most_cost_above must not be negative");
        require(most_candidates > 0 && most_ranges > 0, "most_candidates and most_ranges must be positive");
        const auto found = search_placements(
            known, own, measured, sigma, nlos_odds,
            {height_sigma, has_yaw, loss, apart, most_candidates, most_ranges, most_cost_above});
        Eigen::Matrix<double, Eigen::Dynamic, 5, Eigen::RowMajor> out(static_cast<Eigen::Index>(found.size()),
                                                                      5);
        for (size_t k = 0; k < found.size(); ++k) {
          const Placement& at = found[k];
          out.row(static_cast<Eigen::Index>(k)) << at.x, at.y, at.z, at.yaw, at.cost;
        }
        return out;
      },
      "known"_a, "own"_a, "measured"_a, "sigma"_a, "nlos_odds"_a, "height_sigma"_a, "has_yaw"_a, "loss"_a,
      "apart"_a, "most_candidates"_a, "most_ranges"_a, "most_cost_above"_a);
}

}  // namespace synchronizar
