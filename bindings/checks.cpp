#include "bindings/checks.h"

#include <nanobind/nanobind.h>

#include <algorithm>
#include <cmath>

namespace synchronizar {

void require(bool good, const char* fault) {
  if (!good) throw nanobind::value_error(fault);
}

void check_ranges(const Points& i, const Points& j, const Column& measured, const Column& sigma,
                  const Column& nlos_odds) {
  const auto n = measured.size();
  require(n > 0, "at least one range is needed");
  require(i.rows() == n && j.rows() == n, "antenna positions must be (n, 3), one row a range");
  require(sigma.size() == n && nlos_odds.size() == n, "sigma and nlos_odds must be (n,)");
  require(i.allFinite() && j.allFinite() && measured.allFinite(), "positions and distances must be finite");
  require((sigma.array() > 0.0).all() && sigma.allFinite(), "sigma must be positive");
  require((nlos_odds.array() >= 0.0).all() && nlos_odds.allFinite(), "nlos_odds must not be negative");
}

void check_nlos_odds(const Column& nlos_odds, Eigen::Index n) {
  require(nlos_odds.size() == n, "nlos_odds must be (n,)");
  require((nlos_odds.array() >= 0.0).all() && nlos_odds.allFinite(), "nlos_odds must not be negative");
}

void check_range_weight(const Column& range_weight, Eigen::Index n) {
  require(range_weight.size() == n && (range_weight.array() > 0.0).all() && range_weight.allFinite(),
          "range_weight must be (n,) and positive");
}

void check_antennas(const Antennas& antennas, Eigen::Index n) {
  require(antennas.lever.rows() == n && antennas.velocity.rows() == n,
          "levers and velocities must be (n, 3), one row a range");
  require(antennas.lever.allFinite() && antennas.velocity.allFinite(),
          "levers and velocities must be finite");
}

void check_bounds(const Numbers& bounds, Eigen::Index n) {
  require(bounds.size() > 0 && bounds[0] == 0 && bounds[bounds.size() - 1] == n &&
              std::is_sorted(bounds.begin(), bounds.end()),
          "bounds must grow from 0 to n");
}

Loss make_loss(const LossKind& kind, double annealing) {
  require(annealing >= 1.0 && std::isfinite(annealing), "annealing must be at least 1");
  return {kind, annealing};
}

void check_sorted_in_pairs(const Numbers& bounds, const Column& t) {
  for (Eigen::Index p = 0; p + 1 < bounds.size(); ++p) {
    require(std::is_sorted(t.begin() + bounds[p], t.begin() + bounds[p + 1]),
            "t must be sorted within a pair");
  }
}

}  // namespace synchronizar
