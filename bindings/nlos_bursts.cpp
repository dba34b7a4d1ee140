// Chains of ranges without line of sight, and what shifts many of them at once.
#include "factors/nlos_bursts.h"

#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <tuple>
#include <utility>

#include "bindings/bindings.h"
#include "bindings/checks.h"
#include "factors/common_shift.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

namespace {

void check_chain(const Column& t, const Column& whitened, const Column& sigma, const Column& nlos_odds) {
  const auto n = t.size();
  require(whitened.size() == n && sigma.size() == n && nlos_odds.size() == n, "all columns must be (n,)");
  require(whitened.allFinite() && nlos_odds.allFinite() && (nlos_odds.array() >= 0.0).all(),
          "residuals must be finite, odds not negative");
  require((sigma.array() > 0.0).all() && sigma.allFinite(), "sigma must be positive");
  require(t.allFinite(), "t must be finite");
}

// Chains of several pairs, one after the other.
void check_chains(const Numbers& bounds, const Column& t, const Column& whitened, const Column& sigma,
                  const Column& nlos_odds) {
  check_bounds(bounds, t.size());
  check_chain(t, whitened, sigma, nlos_odds);
  check_sorted_in_pairs(bounds, t);
}

}  // namespace

void bind_nlos_bursts(nb::module_& m) {
  nb::class_<Bursts>(m, "Bursts")
      .def(nb::new_([](double share, double mean_duration, double keeps_length, double fluctuation) {
             require(0.0 < share && share < 1.0 && mean_duration > 0.0,
                     "share must be in (0, 1), mean_duration positive");
             require(0.0 <= keeps_length && keeps_length <= 1.0 && fluctuation >= 0.0,
                     "keeps_length must be in [0, 1], fluctuation not negative");
             return Bursts{share, mean_duration, keeps_length, fluctuation, {}};
           }),
           "share"_a, "mean_duration"_a, "keeps_length"_a, "fluctuation"_a)
      .def(
          "with_foreign",
          [](Bursts bursts, double share, double mean_duration, double speed, double scale, double least) {
            require(0.0 <= share && share < 1.0 && mean_duration > 0.0,
                    "share must be in [0, 1), mean_duration positive");
            require(speed >= 0.0 && scale > 0.0 && least > 0.0,
                    "speed must not be negative, scale and least positive");
            bursts.foreign = {share, mean_duration, speed, scale, least};
            return bursts;
          },
          "share"_a, "mean_duration"_a, "speed"_a, "scale"_a, "least"_a);

  m.def(
      "burst_nlos_odds",
      [](const Column& t, const Column& whitened, const Column& sigma, const Column& nlos_odds,
         const NlosMixture& loss, const Bursts& bursts) {
        check_chain(t, whitened, sigma, nlos_odds);
        require(std::is_sorted(t.begin(), t.end()), "t must be sorted");
        const BurstOdds found = burst_nlos_odds(t, whitened, sigma, nlos_odds, loss, bursts);
        return std::pair(found.nlos_odds, found.cost);
      },
      "t"_a, "whitened"_a, "sigma"_a, "nlos_odds"_a, "loss"_a, "bursts"_a);

  m.def(
      "burst_nlos_odds_of_pairs",
      [](const Numbers& bounds, const Column& t, const Column& whitened, const Column& sigma,
         const Column& nlos_odds, const NlosMixture& loss, const Bursts& bursts) {
        check_chains(bounds, t, whitened, sigma, nlos_odds);
        const PairsBurstOdds found = burst_nlos_odds(bounds, t, whitened, sigma, nlos_odds, loss, bursts);
        return std::pair(found.nlos_odds, found.cost);
      },
      "bounds"_a, "t"_a, "whitened"_a, "sigma"_a, "nlos_odds"_a, "loss"_a, "bursts"_a);
  m.def(
      "foreign_or_nlos_of_pairs",
      [](const Numbers& bounds, const Column& t, const Column& measured, const Column& whitened,
         const Column& sigma, const Column& nlos_odds, const Column& worth, const NlosMixture& loss,
         const Bursts& bursts) {
        check_chains(bounds, t, whitened, sigma, nlos_odds);
        require(measured.size() == t.size() && measured.allFinite(), "all columns must be (n,), finite");
        require(worth.size() == bounds.size() - 1 && (worth.array() > 0.0).all(),
                "worth must be (p,), positive");
        const PairsBurstOdds found =
            burst_nlos_odds(bounds, t, whitened, sigma, nlos_odds, loss, bursts, &measured, &worth);
        const bool any = found.foreign.size() > 0;
        return std::tuple(found.nlos_odds, any ? found.foreign : Column(Column::Zero(t.size())), found.cost);
      },
      "bounds"_a, "t"_a, "measured"_a, "whitened"_a, "sigma"_a, "nlos_odds"_a, "worth"_a, "loss"_a,
      "bursts"_a);

  m.def(
      "common_shift",
      [](const Numbers& bounds, const Column& t, const Points& away, const Column& distance,
         const Column& sigma, const Column& nlos_odds, const Column& share, const Column& weight,
         const Eigen::Vector3d& precision, const Points& starts, const NlosMixture& loss,
         const Bursts& bursts) {
        const auto n = t.size();
        check_bounds(bounds, n);
        require(away.rows() == n && distance.size() == n && sigma.size() == n && nlos_odds.size() == n &&
                    share.size() == n,
                "all columns must be (n,), away (n, 3)");
        require(weight.size() + 1 == bounds.size(), "weight must be (p,)");
        require(t.allFinite() && away.allFinite() && distance.allFinite() && share.allFinite() &&
                    weight.allFinite() && starts.allFinite(),
                "numbers must be finite");
        require(sigma.allFinite() && (sigma.array() > 0.0).all() && (precision.array() > 0.0).all(),
                "sigma and precision must be positive");
        require(nlos_odds.allFinite() && (nlos_odds.array() >= 0.0).all(), "odds must not be negative");
        check_sorted_in_pairs(bounds, t);
        const CommonShift found = common_shift({bounds, t, away, distance, sigma, nlos_odds, share, weight},
                                               precision, starts, loss, bursts);
        return std::pair(found.shift, found.gain);
      },
      "bounds"_a, "t"_a, "away"_a, "distance"_a, "sigma"_a, "nlos_odds"_a, "share"_a, "weight"_a,
      "precision"_a, "starts"_a, "loss"_a, "bursts"_a);
}

}  // namespace synchronizar
