// Tests of what new ranges say against a prediction.
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "bindings/bindings.h"
#include "bindings/checks.h"
#include "factors/innovation_tests.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

namespace {

void check_innovations(const Innovations& rows) {
  require(rows.cols() == kInnovationColumns, "innovations have eleven columns");
  require(rows.allFinite(), "innovations must be finite");
  require(rows.rows() == 0 || (rows.col(kSigma).minCoeff() > 0.0 && rows.col(kOdds).minCoeff() >= 0.0),
          "sigma must be positive, odds not negative");
  require(rows.rows() == 0 || std::min(rows.col(kUserI).minCoeff(), rows.col(kUserJ).minCoeff()) >= 0.0,
          "an innovation names a user that is not there");
}

}  // namespace

void bind_innovations(nb::module_& m) {
  m.def(
      "shifted_groups",
      [](const Innovations& rows, const std::vector<std::tuple<double, double, bool>>& stretches,
         double fewest, double sigma, double looked_at, const NlosMixture& loss, const Bursts& bursts) {
        check_innovations(rows);
        require(sigma > 0.0, "sigma must be positive");
        std::vector<std::tuple<std::vector<int>, Eigen::Vector3d, double>> out;
        for (const auto& [since, until, grows] : stretches) {
          require(since < until, "a stretch must have a length");
          for (auto& [users, shift, gain] :
               shifted_groups(rows, {since, until, grows}, {fewest, sigma, looked_at}, loss, bursts)) {
            out.emplace_back(std::move(users), shift, gain);
          }
        }
        return out;
      },
      "rows"_a, "stretches"_a, "fewest"_a, "sigma"_a, "looked_at"_a, "loss"_a, "bursts"_a);

  m.def(
      "worst_misfit",
      [](const Innovations& rows, const std::vector<std::pair<double, bool>>& stretches, double sigmas,
         double fewest, double many, double short_share,
         double off_share) -> std::optional<std::tuple<size_t, int, double>> {
        check_innovations(rows);
        require(0.0 < short_share && short_share < 1.0 && off_share > 0.0, "shares must be in (0, 1)");
        for (size_t n = 0; n < stretches.size(); ++n) {
          const auto [since, lasting] = stretches[n];
          const auto found =
              worst_misfit(rows, since, {sigmas, fewest, many, short_share, off_share, lasting});
          if (found) return std::tuple(n, found->user, found->share);
        }
        return std::nullopt;
      },
      "rows"_a, "stretches"_a, "sigmas"_a, "fewest"_a, "many"_a, "short_share"_a, "off_share"_a);
}

}  // namespace synchronizar
