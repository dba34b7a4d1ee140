// The optimisation of whole walks.
#include "factors/walk_solver.h"

#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <tuple>
#include <vector>

#include "bindings/bindings.h"
#include "bindings/checks.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

namespace {

void check_states(const WalkSolver& solver, const WalkStates& states) {
  const Walks& walks = solver.walks();
  require(states.places.rows() == walks.t.size() && states.calibration.rows() == walks.users &&
              states.lasting.size() == walks.follows.size(),
          "places must have one row a keyframe, calibration one a user, lasting one number a lasting error");
  require(states.places.allFinite() && states.calibration.allFinite() && states.lasting.allFinite(),
          "states must be finite");
}

void check_states(const WalkSolver& solver, const WalkStates& states, const WalkNoise& noise) {
  check_states(solver, states);
  const Walks& walks = solver.walks();
  require(noise.nlos_odds.size() == walks.measured.size() &&
              noise.step_sigma.rows() == states.places.rows() && noise.about.rows() == walks.users &&
              noise.lasting_sigma.size() == walks.follows.size(),
          "the noise is that of other walks");
}

}  // namespace

void bind_walk_solver(nb::module_& m) {
  nb::class_<WalkNoise>(m, "WalkNoise")
      .def(
          "__init__",
          [](WalkNoise* self, const Column& nlos_odds, const Column& range_weight,
             const ThreeColumns& step_sigma, const WalkPlaces& about, const Column& place_sigma,
             double yaw_sigma, const Column& height_sigma, const Marks& surveyed,
             const ThreeColumns& device_sigma, const Column& known_bias_sigma, const Vector3& shared_sigma,
             const Column& assumed_clock, const Column& lasting_sigma, const Column& level_information) {
            check_nlos_odds(nlos_odds, range_weight.size());
            check_range_weight(range_weight, range_weight.size());
            const auto k = about.rows();
            require(place_sigma.size() == k && height_sigma.size() == k && surveyed.size() == k &&
                        device_sigma.rows() == k && known_bias_sigma.size() == k && assumed_clock.size() == k,
                    "priors must have one row a user");
            require((place_sigma.array() > 0.0).all() && yaw_sigma > 0.0 &&
                        (height_sigma.array() > 0.0).all() && (device_sigma.array() > 0.0).all() &&
                        (known_bias_sigma.array() > 0.0).all() && (shared_sigma.array() > 0.0).all() &&
                        (step_sigma.array() > 0.0).all() && (lasting_sigma.array() > 0.0).all(),
                    "sigmas must be positive");
            require(level_information.size() == step_sigma.rows() && level_information.allFinite() &&
                        (level_information.array() >= 0.0).all(),
                    "level_information must be one number a keyframe, none negative");
            require(about.allFinite() && assumed_clock.allFinite() && step_sigma.allFinite(),
                    "priors must be finite");
            new (self) WalkNoise{nlos_odds,     range_weight,     step_sigma,   about,
                                 place_sigma,   yaw_sigma,        height_sigma, surveyed,
                                 device_sigma,  known_bias_sigma, shared_sigma, assumed_clock,
                                 lasting_sigma, level_information};
          },
          "nlos_odds"_a, "range_weight"_a, "step_sigma"_a, "about"_a, "place_sigma"_a, "yaw_sigma"_a,
          "height_sigma"_a, "surveyed"_a, "device_sigma"_a, "known_bias_sigma"_a, "shared_sigma"_a,
          "assumed_clock"_a, "lasting_sigma"_a, "level_information"_a);

  nb::class_<WalkSolver>(m, "WalkSolver")
      .def(
          "__init__",
          [](WalkSolver* self, int reference, const Numbers& first, const Column& t, const Points& slam,
             const Numbers& keyframe_i, const Numbers& keyframe_j, const std::array<Points, 3>& i,
             const std::array<Points, 3>& j, const Column& measured, const Column& sigma,
             const Numbers& lasting, const Numbers& follows, const Column& decay) {
            check_bounds(first, t.size());
            const int users = static_cast<int>(first.size()) - 1;
            require(0 <= reference && reference < users, "the reference is nobody");
            for (int u = 0; u < users; ++u) require(first[u] < first[u + 1], "a user has no keyframe");
            require(slam.rows() == t.size() && slam.allFinite() && t.allFinite(),
                    "t and slam must have one row a keyframe and be finite");
            const auto n = measured.size();
            require(keyframe_i.size() == n && keyframe_j.size() == n, "keyframes must be (n,)");
            if (n > 0) {
              check_ranges(i[0], j[0], measured, sigma, Column::Zero(n));
              require(keyframe_i.minCoeff() >= 0 && keyframe_j.minCoeff() >= 0 &&
                          keyframe_i.maxCoeff() < t.size() && keyframe_j.maxCoeff() < t.size(),
                      "a range names a keyframe that is not there");
            }
            const Antennas at_i{i[0], i[1], i[2]}, at_j{j[0], j[1], j[2]};
            check_antennas(at_i, n);
            check_antennas(at_j, n);
            const auto v = follows.size();
            require(lasting.size() == (v == 0 ? 0 : n) && decay.size() == v,
                    "lasting must be (n,), follows and decay (v,)");
            if (v > 0) {
              require(n > 0 && lasting.minCoeff() >= 0 && lasting.maxCoeff() < v,
                      "a lasting error is not there");
              Marks had = Marks::Constant(v, false);
              for (const int which : lasting) had[which] = true;
              require(had.all(), "a lasting error is no range's");
              for (Eigen::Index which = 0; which < v; ++which) {
                require(-1 <= follows[which] && follows[which] < which,
                        "a lasting error follows none before it");
                require(
                    0.0 <= decay[which] && decay[which] < 1.0 && (follows[which] >= 0 || decay[which] == 0.0),
                    "decay must be in [0, 1), and 0 where nothing is followed");
              }
            }
            new (self) WalkSolver(Walks{users, reference, first, t, slam, keyframe_i, keyframe_j, at_i, at_j,
                                        measured, sigma, lasting, follows, decay});
          },
          "reference"_a, "first"_a, "t"_a, "slam"_a, "keyframe_i"_a, "keyframe_j"_a, "i"_a, "j"_a,
          "measured"_a, "sigma"_a, "lasting"_a = Numbers(), "follows"_a = Numbers(), "decay"_a = Column())
      .def(
          "residuals",
          [](const WalkSolver& self, const WalkPlaces& places, const ThreeColumns& calibration,
             const Column& lasting, const Column& assumed_clock) {
            const WalkStates states{places, calibration, lasting};
            check_states(self, states);
            require(assumed_clock.size() == self.walks().users, "assumed_clock must be (k,)");
            return self.residuals(states, assumed_clock);
          },
          "places"_a, "calibration"_a, "lasting"_a, "assumed_clock"_a)
      .def(
          "cost",
          [](const WalkSolver& self, const WalkPlaces& places, const ThreeColumns& calibration,
             const Column& lasting, const WalkNoise& noise, const LossKind& loss, double annealing) {
            const WalkStates states{places, calibration, lasting};
            check_states(self, states, noise);
            return self.cost(states, noise, make_loss(loss, annealing));
          },
          "places"_a, "calibration"_a, "lasting"_a, "noise"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "gradient",
          [](const WalkSolver& self, const WalkPlaces& places, const ThreeColumns& calibration,
             const Column& lasting, const WalkNoise& noise, const LossKind& loss, double annealing) {
            const WalkStates states{places, calibration, lasting};
            check_states(self, states, noise);
            const WalkStates out = self.gradient(states, noise, make_loss(loss, annealing));
            return std::tuple(out.places, out.calibration, out.lasting);
          },
          "places"_a, "calibration"_a, "lasting"_a, "noise"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "optimize",
          [](const WalkSolver& self, const WalkPlaces& places, const ThreeColumns& calibration,
             const Column& lasting, const WalkNoise& noise, const LossKind& loss, double annealing, int steps,
             double gain) {
            const WalkStates states{places, calibration, lasting};
            check_states(self, states, noise);
            const WalkStates out = self.optimize(states, noise, make_loss(loss, annealing), steps, gain);
            return std::tuple(out.places, out.calibration, out.lasting);
          },
          "places"_a, "calibration"_a, "lasting"_a, "noise"_a, "loss"_a, "annealing"_a, "steps"_a, "gain"_a)
      .def(
          "covariance",
          [](const WalkSolver& self, const WalkPlaces& places, const ThreeColumns& calibration,
             const Column& lasting, const WalkNoise& noise, const LossKind& loss,
             const Column& height_curvature, const Numbers& keyframes) {
            const WalkStates states{places, calibration, lasting};
            check_states(self, states, noise);
            require(height_curvature.size() == self.walks().measured.size(), "height_curvature must be (n,)");
            require(
                keyframes.size() == 0 || (keyframes.minCoeff() >= 0 && keyframes.maxCoeff() < places.rows()),
                "a keyframe is not there");
            return self.covariance(states, noise, make_loss(loss, 1.0), height_curvature, keyframes);
          },
          "places"_a, "calibration"_a, "lasting"_a, "noise"_a, "loss"_a, "height_curvature"_a, "keyframes"_a)
      .def(
          "step_noise",
          [](const WalkSolver& self, const WalkPlaces& places, const ThreeColumns& calibration,
             const Column& lasting, const WalkNoise& noise, const LossKind& loss, const Marks& kept,
             const Marks& counted, const Column& tried, double begin, double weight, int rounds) {
            const WalkStates states{places, calibration, lasting};
            check_states(self, states, noise);
            require(kept.size() == places.rows() && counted.size() == places.rows(),
                    "kept and counted must be (m,)");
            for (const int first : self.walks().first) {
              require(first == counted.size() || !counted[first], "no step leads to a user's first keyframe");
            }
            require(tried.size() > 0 && tried.minCoeff() > 0.0, "tried must be positive");
            require(begin > 0.0, "begin must be positive");
            const auto found = self.step_noise(states, noise, make_loss(loss, 1.0), kept,
                                               {counted, tried, begin, weight, rounds});
            std::vector<Eigen::MatrixXd> factors;
            Column evidence(tried.size()), determined(tried.size());
            for (size_t b = 0; b < found.size(); ++b) {
              factors.push_back(found[b].factors);
              evidence[static_cast<Eigen::Index>(b)] = found[b].evidence;
              determined[static_cast<Eigen::Index>(b)] = found[b].determined;
            }
            return std::tuple(factors, evidence, determined);
          },
          "places"_a, "calibration"_a, "lasting"_a, "noise"_a, "loss"_a, "kept"_a, "counted"_a, "tried"_a,
          "begin"_a, "weight"_a, "rounds"_a)
      .def(
          "log_determinant",
          [](const WalkSolver& self, const WalkPlaces& places, const ThreeColumns& calibration,
             const Column& lasting, const WalkNoise& noise, const LossKind& loss,
             const Column& height_curvature) {
            const WalkStates states{places, calibration, lasting};
            check_states(self, states, noise);
            require(height_curvature.size() == self.walks().measured.size(), "height_curvature must be (n,)");
            return self.log_determinant(states, noise, make_loss(loss, 1.0), height_curvature);
          },
          "places"_a, "calibration"_a, "lasting"_a, "noise"_a, "loss"_a, "height_curvature"_a);
}

}  // namespace synchronizar
