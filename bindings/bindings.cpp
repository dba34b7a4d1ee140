// Python bindings of the core: arrays in, arrays out. Shapes and signs are checked here; faults raise
// ValueError.
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <tuple>
#include <utility>

#include "factors/adjustment.h"
#include "factors/by_serial.h"
#include "factors/common_shift.h"
#include "factors/followed_ranges.h"
#include "factors/height_search.h"
#include "factors/innovation_tests.h"
#include "factors/mixture_terms.h"
#include "factors/neighbours.h"
#include "factors/nlos_bursts.h"
#include "factors/placement_search.h"
#include "factors/pose_table.h"
#include "factors/range_block.h"
#include "factors/range_slot.h"
#include "factors/residual_statistics.h"
#include "factors/rigid_solver.h"
#include "factors/walk_solver.h"

namespace nb = nanobind;
using namespace nb::literals;
using namespace synchronizar;

namespace {

void require(bool good, const char* fault) {
  if (!good) throw nb::value_error(fault);
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

double positive(double parameter) {
  require(parameter > 0.0 && std::isfinite(parameter), "a loss's scale must be positive");
  return parameter;
}

Loss make_loss(const LossKind& kind, double annealing) {
  require(annealing >= 1.0 && std::isfinite(annealing), "annealing must be at least 1");
  return {kind, annealing};
}

using PoseArray = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void check_pose_columns(const PoseTable& table, const std::array<int, 3>& columns) {
  for (size_t k = 0; k < 3; ++k) {
    require(columns[k] >= 0 && columns[k] + (k == 0   ? 1
                                             : k == 1 ? 3
                                                      : 4) <=
                                   table.cols(),
            "the poses have no such column");
  }
}

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

void check_innovations(const Innovations& rows) {
  require(rows.cols() == kInnovationColumns, "innovations have eleven columns");
  require(rows.allFinite(), "innovations must be finite");
  require(rows.rows() == 0 || (rows.col(kSigma).minCoeff() > 0.0 && rows.col(kOdds).minCoeff() >= 0.0),
          "sigma must be positive, odds not negative");
  require(rows.rows() == 0 || std::min(rows.col(kUserI).minCoeff(), rows.col(kUserJ).minCoeff()) >= 0.0,
          "an innovation names a user that is not there");
}

void check_antennas(const Antennas& antennas, Eigen::Index n) {
  require(antennas.lever.rows() == n && antennas.velocity.rows() == n,
          "levers and velocities must be (n, 3), one row a range");
  require(antennas.lever.allFinite() && antennas.velocity.allFinite(),
          "levers and velocities must be finite");
}

void check_range_weight(const Column& range_weight, Eigen::Index n) {
  require(range_weight.size() == n && (range_weight.array() > 0.0).all() && range_weight.allFinite(),
          "range_weight must be (n,) and positive");
}

std::vector<std::pair<Column, double>> told(const std::vector<Heights>& found) {
  std::vector<std::pair<Column, double>> out;
  for (const Heights& of : found) out.emplace_back(of.height, of.cost);
  return out;
}

void check_nlos_odds(const Column& nlos_odds, Eigen::Index n) {
  require(nlos_odds.size() == n, "nlos_odds must be (n,)");
  require((nlos_odds.array() >= 0.0).all() && nlos_odds.allFinite(), "nlos_odds must not be negative");
}

void check_bounds(const Numbers& bounds, Eigen::Index n) {
  require(bounds.size() > 0 && bounds[0] == 0 && bounds[bounds.size() - 1] == n &&
              std::is_sorted(bounds.begin(), bounds.end()),
          "bounds must grow from 0 to n");
}

template <class Poses>
void check_slot(const RangeSlot& slot, const Poses& poses, const SlotCalibrations& calibrations,
                const std::optional<Column>& height_curvature = std::nullopt) {
  require(poses.rows() == slot.users() && calibrations.rows() == slot.users(),
          "poses and calibrations must have one row a user");
  require(!height_curvature || static_cast<size_t>(height_curvature->size()) == slot.pairs().size(),
          "height_curvature must have one number a pair");
}

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

void check_frames(const RigidSolver& solver, const Frames& frames) {
  require(frames.rows() == solver.users(), "frames must be (k, 4)");
}

template <class Kind>
void bind_loss(nb::class_<Kind>& loss) {
  loss.def(
      "__call__",
      [](const Kind& kind, double e, double sigma, double nlos_odds) {
        const LossValue value = kind(e, {sigma, nlos_odds});
        return std::tuple(value.rho, value.weight, value.curvature);
      },
      "e"_a, "sigma"_a = 1.0, "nlos_odds"_a = 0.0,
      "(rho, weight, curvature) of a whitened residual e = (predicted - measured) / sigma");
}

}  // namespace

NB_MODULE(_core, m) {
  nb::class_<UserPose>(m, "UserPose")
      .def(nb::init<double, double, double, double, double, double, double, double>(), "frame_x"_a = 0.0,
           "frame_y"_a = 0.0, "frame_yaw"_a = 0.0, "frame_height"_a = 0.0, "local_x"_a = 0.0,
           "local_y"_a = 0.0, "local_yaw"_a = 0.0, "local_height"_a = 0.0);

  nb::class_<Squared> squared(m, "Squared");
  squared.def(nb::init<>());
  bind_loss(squared);
  nb::class_<Huber> huber(m, "Huber");
  huber.def(nb::new_([](double k) { return Huber{positive(k)}; }), "k"_a = Huber{}.k).def_ro("k", &Huber::k);
  bind_loss(huber);
  nb::class_<Cauchy> cauchy(m, "Cauchy");
  cauchy.def(nb::new_([](double k) { return Cauchy{positive(k)}; }), "k"_a = Cauchy{}.k)
      .def_ro("k", &Cauchy::k);
  bind_loss(cauchy);
  nb::class_<GemanMcClure> geman_mcclure(m, "GemanMcClure");
  geman_mcclure.def(nb::new_([](double k) { return GemanMcClure{positive(k)}; }), "k"_a = GemanMcClure{}.k)
      .def_ro("k", &GemanMcClure::k);
  bind_loss(geman_mcclure);
  nb::class_<NlosMixture> nlos(m, "NlosMixture");
  nlos.def(nb::new_([](double scale, double early_odds) {
             require(early_odds >= 0.0, "early_odds must not be negative");
             return NlosMixture{positive(scale), early_odds};
           }),
           "scale"_a, "early_odds"_a)
      .def_ro("scale", &NlosMixture::scale)
      .def_ro("early_odds", &NlosMixture::early_odds);
  bind_loss(nlos);

  nb::class_<RangeBlock>(m, "RangeBlock")
      .def(
          "__init__",
          [](RangeBlock* self, const Points& o_i, const Points& o_j, const Column& measured,
             const Column& sigma, const Column& nlos_odds) {
            check_ranges(o_i, o_j, measured, sigma, nlos_odds);
            new (self) RangeBlock(o_i, o_j, measured, sigma, nlos_odds);
          },
          "o_i"_a, "o_j"_a, "measured"_a, "sigma"_a, "nlos_odds"_a)
      .def("__len__", &RangeBlock::size)
      .def("residuals", &RangeBlock::residuals, "i"_a, "j"_a)
      .def(
          "cost",
          [](const RangeBlock& self, const UserPose& i, const UserPose& j, const LossKind& loss,
             double annealing) { return self.cost(i, j, make_loss(loss, annealing)); },
          "i"_a, "j"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "square_root",
          [](const RangeBlock& self, const UserPose& i, const UserPose& j, const LossKind& loss,
             double annealing) { return self.square_root(i, j, make_loss(loss, annealing)); },
          "i"_a, "j"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "height_curvature",
          [](const RangeBlock& self, const UserPose& i, const UserPose& j, const LossKind& loss,
             double annealing) { return self.height_curvature(i, j, make_loss(loss, annealing)); },
          "i"_a, "j"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "weights",
          [](const RangeBlock& self, const UserPose& i, const UserPose& j, const LossKind& loss,
             double annealing) { return self.weights(i, j, make_loss(loss, annealing)); },
          "i"_a, "j"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "with_nlos_odds",
          [](const RangeBlock& self, const Column& nlos_odds) {
            check_nlos_odds(nlos_odds, self.size());
            return self.with_nlos_odds(nlos_odds);
          },
          "nlos_odds"_a)
      .def("inlier_probability", &RangeBlock::inlier_probability, "i"_a, "j"_a, "loss"_a);

  nb::class_<RangeSlot>(m, "RangeSlot")
      .def(
          "__init__",
          [](RangeSlot* self, int users, const Numbers& user_i, const Numbers& user_j,
             const std::array<Points, 3>& i, const std::array<Points, 3>& j, const Column& measured,
             const Column& sigma, const Column& nlos_odds, const Column& range_weight) {
            check_ranges(i[0], j[0], measured, sigma, nlos_odds);
            check_range_weight(range_weight, measured.size());
            require(user_i.size() == measured.size() && user_j.size() == measured.size(),
                    "user_i and user_j must be (n,)");
            require((user_i.array() >= 0).all() && (user_j.array() >= 0).all() &&
                        (user_i.array() < users).all() && (user_j.array() < users).all(),
                    "a range names a user that is not there");
            require((user_i.array() != user_j.array()).all(), "a range is between two users");
            const Antennas at_i{i[0], i[1], i[2]}, at_j{j[0], j[1], j[2]};
            check_antennas(at_i, measured.size());
            check_antennas(at_j, measured.size());
            new (self) RangeSlot(users, user_i, user_j, at_i, at_j, measured, sigma, nlos_odds, range_weight);
          },
          "users"_a, "user_i"_a, "user_j"_a, "i"_a, "j"_a, "measured"_a, "sigma"_a, "nlos_odds"_a,
          "range_weight"_a)
      .def("__len__", &RangeSlot::size)
      .def_prop_ro("users", &RangeSlot::users)
      .def_prop_ro("pairs", &RangeSlot::pairs)
      .def(
          "with_weights",
          [](const RangeSlot& self, const Column& nlos_odds, const Column& range_weight) {
            check_nlos_odds(nlos_odds, self.size());
            check_range_weight(range_weight, self.size());
            return self.with_weights(nlos_odds, range_weight);
          },
          "nlos_odds"_a, "range_weight"_a)
      .def(
          "residuals",
          [](const RangeSlot& self, const SlotPoses& poses, const SlotCalibrations& calibrations) {
            check_slot(self, poses, calibrations);
            return self.residuals(poses, calibrations);
          },
          "poses"_a, "calibrations"_a)
      .def(
          "cost",
          [](const RangeSlot& self, const SlotPoses& poses, const SlotCalibrations& calibrations,
             const LossKind& loss, double annealing) {
            check_slot(self, poses, calibrations);
            return self.cost(poses, calibrations, make_loss(loss, annealing));
          },
          "poses"_a, "calibrations"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "square_root",
          [](const RangeSlot& self, const SlotPoses& poses, const SlotCalibrations& calibrations,
             const LossKind& loss, double annealing, const std::optional<Column>& height_curvature) {
            check_slot(self, poses, calibrations, height_curvature);
            return self.square_root(poses, calibrations, make_loss(loss, annealing), height_curvature);
          },
          "poses"_a, "calibrations"_a, "loss"_a, "annealing"_a = 1.0, "height_curvature"_a = nb::none())
      .def(
          "square_root_frames",
          [](const RangeSlot& self, const RangeSlot::SlotFrames& frames, const SlotCalibrations& calibrations,
             const LossKind& loss, double annealing, const std::optional<Column>& height_curvature) {
            check_slot(self, frames, calibrations, height_curvature);
            return self.square_root_frames(frames, calibrations, make_loss(loss, annealing),
                                           height_curvature);
          },
          "frames"_a, "calibrations"_a, "loss"_a, "annealing"_a = 1.0, "height_curvature"_a = nb::none());

  nb::class_<WalkNoise>(m, "WalkNoise")
      .def(
          "__init__",
          [](WalkNoise* self, const Column& nlos_odds, const Column& range_weight,
             const ThreeColumns& step_sigma, const WalkPlaces& about, const Column& place_sigma,
             double yaw_sigma, const Column& height_sigma, const Marks& surveyed,
             const ThreeColumns& device_sigma, const Column& known_bias_sigma, const Vector3& shared_sigma,
             const Column& assumed_clock, const Column& lasting_sigma) {
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
            require(about.allFinite() && assumed_clock.allFinite() && step_sigma.allFinite(),
                    "priors must be finite");
            new (self) WalkNoise{nlos_odds,    range_weight,  step_sigma,   about,        place_sigma,
                                 yaw_sigma,    height_sigma,  surveyed,     device_sigma, known_bias_sigma,
                                 shared_sigma, assumed_clock, lasting_sigma};
          },
          "nlos_odds"_a, "range_weight"_a, "step_sigma"_a, "about"_a, "place_sigma"_a, "yaw_sigma"_a,
          "height_sigma"_a, "surveyed"_a, "device_sigma"_a, "known_bias_sigma"_a, "shared_sigma"_a,
          "assumed_clock"_a, "lasting_sigma"_a = Column());

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
            const auto found = self.step_noise(states, noise, make_loss(loss, 1.0), kept, counted, tried,
                                               begin, weight, rounds);
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

  nb::class_<RigidSolver>(m, "RigidSolver")
      .def(
          "__init__",
          [](RigidSolver* self, const RigidSolver::Marks& active, int reference, const Numbers& first,
             const Numbers& user_i, const Numbers& user_j, const Column& t, const Points& i, const Points& j,
             const Column& measured, const Column& sigma, const Column& nlos_odds, const Column& height_sigma,
             double place_sigma, double yaw_sigma, const Points& survey, const Column& survey_sigma,
             double survey_dof, const NlosMixture& loss) {
            const auto n = measured.size(), k = active.size(), pairs = user_i.size();
            check_bounds(first, n);
            require(t.size() == n && t.allFinite(), "t must be (n,) and finite");
            if (n > 0) check_ranges(i, j, measured, sigma, nlos_odds);
            require(0 <= reference && reference < k && active[reference], "the reference must be active");
            require(first.size() == pairs + 1 && user_j.size() == pairs,
                    "users must be (p,), first (p + 1,)");
            for (Eigen::Index p = 0; p < pairs; ++p) {
              require(0 <= user_i[p] && user_i[p] < k && 0 <= user_j[p] && user_j[p] < k &&
                          active[user_i[p]] && active[user_j[p]] && user_i[p] != user_j[p],
                      "a pair names a user that is not active");
              require(std::is_sorted(t.begin() + first[p], t.begin() + first[p + 1]),
                      "t must be sorted within a pair");
            }
            require(height_sigma.size() == k && (height_sigma.array() > 0.0).all() && place_sigma > 0.0 &&
                        yaw_sigma > 0.0 && survey_sigma.size() == k && (survey_sigma.array() > 0.0).all() &&
                        survey_dof > 0.0,
                    "sigmas of priors must be positive");
            require(survey.rows() == k, "survey must be (k, 3)");
            new (self)
                RigidSolver({first, user_i, user_j, t, i, j, measured, sigma, nlos_odds}, active, reference,
                            {height_sigma, place_sigma, yaw_sigma, survey, survey_sigma, survey_dof}, loss);
          },
          "active"_a, "reference"_a, "first"_a, "user_i"_a, "user_j"_a, "t"_a, "i"_a, "j"_a, "measured"_a,
          "sigma"_a, "nlos_odds"_a, "height_sigma"_a, "place_sigma"_a, "yaw_sigma"_a, "survey"_a,
          "survey_sigma"_a, "survey_dof"_a, "loss"_a)
      .def(
          "residuals",
          [](const RigidSolver& self, const Frames& frames) {
            check_frames(self, frames);
            return self.residuals(frames);
          },
          "frames"_a)
      .def(
          "cost",
          [](const RigidSolver& self, const Frames& frames, const Column& nlos_odds, double most) {
            check_frames(self, frames);
            check_nlos_odds(nlos_odds, self.size());
            return self.cost(frames, nlos_odds, most);
          },
          "frames"_a, "nlos_odds"_a, "most"_a = std::numeric_limits<double>::infinity())
      .def(
          "e_step",
          [](const RigidSolver& self, const Frames& frames, const Bursts& bursts) {
            check_frames(self, frames);
            return self.e_step(frames, bursts);
          },
          "frames"_a, "bursts"_a)
      .def(
          "optimize",
          [](const RigidSolver& self, const Frames& frames, const Frames& about, const Column& nlos_odds,
             double annealing, int steps, double gain, const std::vector<Frames>& known, double same) {
            check_frames(self, frames);
            check_frames(self, about);
            for (const Frames& other : known) check_frames(self, other);
            check_nlos_odds(nlos_odds, self.size());
            require(annealing >= 1.0, "annealing must be at least 1");
            return self.optimize(frames, about, nlos_odds, annealing, steps, gain, {known, same});
          },
          "frames"_a, "about"_a, "nlos_odds"_a, "annealing"_a, "steps"_a, "gain"_a,
          "known"_a = std::vector<Frames>(), "same"_a = 0.0)
      .def(
          "run_em",
          [](const RigidSolver& self, const Frames& frames, const Column& nlos_odds, const Bursts& bursts,
             double annealing, int rounds, int steps, double gain, const std::vector<Frames>& known,
             double same, double hopeless) {
            check_frames(self, frames);
            for (const Frames& other : known) check_frames(self, other);
            check_nlos_odds(nlos_odds, self.size());
            require(annealing >= 1.0, "annealing must be at least 1");
            RigidOptimum found = self.run_em(frames, nlos_odds, bursts, annealing,
                                             {rounds, steps, gain, {known, same}, hopeless});
            return std::tuple(std::move(found.frames), std::move(found.nlos_odds), found.cost);
          },
          "frames"_a, "nlos_odds"_a, "bursts"_a, "annealing"_a, "rounds"_a, "steps"_a, "gain"_a, "known"_a,
          "same"_a, "hopeless"_a)
      .def(
          "other_heights",
          [](const RigidSolver& self, const Frames& frames, const Column& nlos_odds, double most_above,
             int most) {
            check_frames(self, frames);
            check_nlos_odds(nlos_odds, self.size());
            require(most > 0, "most must be positive");
            return told(self.other_heights(frames, nlos_odds, most_above, most));
          },
          "frames"_a, "nlos_odds"_a, "most_above"_a, "most"_a)
      .def(
          "covariances",
          [](const RigidSolver& self, const Frames& frames, const Column& nlos_odds) {
            check_frames(self, frames);
            check_nlos_odds(nlos_odds, self.size());
            return self.covariances(frames, nlos_odds);
          },
          "frames"_a, "nlos_odds"_a);

  m.def(
      "residual_inflations",
      [](const Numbers& first, const Numbers& user_i, const Numbers& user_j, const Column& t, const Points& i,
         const Points& j, const Frames& frames, const Column& residual, const Column& weight, int pieces) {
        const auto n = t.size(), pairs = user_i.size();
        check_bounds(first, n);
        require(i.rows() == n && j.rows() == n && residual.size() == n && weight.size() == n,
                "all columns must have one row a range");
        require(first.size() == pairs + 1 && user_j.size() == pairs, "users must be (p,), first (p + 1,)");
        require(pairs == 0 || (user_i.minCoeff() >= 0 && user_j.minCoeff() >= 0 &&
                               user_i.maxCoeff() < frames.rows() && user_j.maxCoeff() < frames.rows()),
                "a pair names a user that is not there");
        require(pieces > 0, "pieces must be positive");
        return residual_inflations({first, user_i, user_j, t, i, j}, frames, residual, weight, pieces);
      },
      "first"_a, "user_i"_a, "user_j"_a, "t"_a, "i"_a, "j"_a, "frames"_a, "residual"_a, "weight"_a,
      "pieces"_a);

  m.def("semidefinite_root", &semidefinite_root, "normal"_a);

  nb::class_<Adjustment>(m, "Adjustment")
      .def(
          "__init__",
          [](Adjustment* self, const Numbers& user_i, const Numbers& user_j, const Points& p_i,
             const Points& p_j, const Column& measured, const Points& centre, double sigma, double soft) {
            const auto n = measured.size();
            require(user_i.size() == n && user_j.size() == n && p_i.rows() == n && p_j.rows() == n,
                    "all columns must have one row a range");
            require(n == 0 || (user_i.minCoeff() >= 0 && user_j.minCoeff() >= 0 &&
                               user_i.maxCoeff() < centre.rows() && user_j.maxCoeff() < centre.rows()),
                    "a range names a user that is not there");
            require(sigma > 0.0 && soft > 0.0, "sigma and soft must be positive");
            new (self) Adjustment{user_i, user_j, p_i, p_j, measured, centre, sigma, soft};
          },
          "user_i"_a, "user_j"_a, "p_i"_a, "p_j"_a, "measured"_a, "centre"_a, "sigma"_a, "soft"_a)
      .def(
          "residuals",
          [](const Adjustment& self, const Corrections& at) {
            require(at.rows() == self.centre.rows(), "corrections must be (k, 6)");
            return adjustment_residuals(self, at);
          },
          "at"_a)
      .def(
          "adjust",
          [](const Adjustment& self, const Corrections& at, const Numbers& free, const Column& prior_mean,
             const Column& prior_weight, int steps, double longest, double shortest) {
            require(at.rows() == self.centre.rows(), "corrections must be (k, 6)");
            require(prior_mean.size() == free.size() && prior_weight.size() == free.size(),
                    "priors must be those of the free variables");
            require(free.size() == 0 || (free.minCoeff() >= 0 && free.maxCoeff() < at.size()),
                    "a free variable is not there");
            const Adjusted found = adjust(self, at, free, prior_mean, prior_weight, steps, longest, shortest);
            return std::pair(found.at, found.normal);
          },
          "at"_a, "free"_a, "prior_mean"_a, "prior_weight"_a, "steps"_a, "longest"_a, "shortest"_a);

  m.def(
      "neighbour_counts",
      [](const Numbers& bounds, const Column& t, double reach) {
        check_bounds(bounds, t.size());
        return neighbour_counts(bounds, t, reach);
      },
      "bounds"_a, "t"_a, "reach"_a);

  m.def(
      "neighbour_sums",
      [](const Numbers& bounds, const Column& t, const Numbers& link, const Column& score,
         const Column& weight, double gap, int most) {
        const auto n = t.size();
        check_bounds(bounds, n);
        require(link.size() == n && score.size() == n && weight.size() == n, "all columns must be (n,)");
        require(most > 0, "most must be positive");
        const NeighbourSums sums = neighbour_sums(bounds, t, link, score, weight, gap, most);
        return std::tuple(sums.squares, sums.weights, sums.product, sums.both);
      },
      "bounds"_a, "t"_a, "link"_a, "score"_a, "weight"_a, "gap"_a, "most"_a);

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

  m.def(
      "mixture_terms",
      [](const Column& whitened, const Column& sigma, const Column& nlos_odds, const NlosMixture& loss) {
        const auto n = whitened.size();
        require(sigma.size() == n && nlos_odds.size() == n, "all columns must be (n,)");
        MixtureTerms terms = mixture_terms(whitened, sigma, nlos_odds, loss);
        return std::tuple(std::move(terms.rho), std::move(terms.weight), std::move(terms.inlier_probability));
      },
      "whitened"_a, "sigma"_a, "nlos_odds"_a, "loss"_a);

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
        const auto n = t.size();
        require(whitened.size() == n && sigma.size() == n && nlos_odds.size() == n,
                "all columns must be (n,)");
        require(whitened.allFinite() && nlos_odds.allFinite() && (nlos_odds.array() >= 0.0).all(),
                "residuals must be finite, odds not negative");
        require((sigma.array() > 0.0).all() && sigma.allFinite(), "sigma must be positive");
        require(std::is_sorted(t.begin(), t.end()) && t.allFinite(), "t must be finite and sorted");
        const BurstOdds found = burst_nlos_odds(t, whitened, sigma, nlos_odds, loss, bursts);
        return std::pair(found.nlos_odds, found.cost);
      },
      "t"_a, "whitened"_a, "sigma"_a, "nlos_odds"_a, "loss"_a, "bursts"_a);

  const auto check_chains = [](const Numbers& bounds, const Column& t, const Column& whitened,
                               const Column& sigma, const Column& nlos_odds) {
    const auto n = t.size();
    check_bounds(bounds, n);
    require(whitened.size() == n && sigma.size() == n && nlos_odds.size() == n, "all columns must be (n,)");
    require(whitened.allFinite() && nlos_odds.allFinite() && (nlos_odds.array() >= 0.0).all(),
            "residuals must be finite, odds not negative");
    require((sigma.array() > 0.0).all() && sigma.allFinite(), "sigma must be positive");
    require(t.allFinite(), "t must be finite");
    for (Eigen::Index p = 0; p + 1 < bounds.size(); ++p) {
      require(std::is_sorted(t.begin() + bounds[p], t.begin() + bounds[p + 1]),
              "t must be sorted within a pair");
    }
  };
  m.def(
      "burst_nlos_odds_of_pairs",
      [=](const Numbers& bounds, const Column& t, const Column& whitened, const Column& sigma,
          const Column& nlos_odds, const NlosMixture& loss, const Bursts& bursts) {
        check_chains(bounds, t, whitened, sigma, nlos_odds);
        const PairsBurstOdds found = burst_nlos_odds(bounds, t, whitened, sigma, nlos_odds, loss, bursts);
        return std::pair(found.nlos_odds, found.cost);
      },
      "bounds"_a, "t"_a, "whitened"_a, "sigma"_a, "nlos_odds"_a, "loss"_a, "bursts"_a);
  m.def(
      "foreign_or_nlos_of_pairs",
      [=](const Numbers& bounds, const Column& t, const Column& measured, const Column& whitened,
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
        for (Eigen::Index p = 0; p + 1 < bounds.size(); ++p) {
          require(std::is_sorted(t.begin() + bounds[p], t.begin() + bounds[p + 1]),
                  "t must be sorted within a pair");
        }
        const CommonShift found = common_shift({bounds, t, away, distance, sigma, nlos_odds, share, weight},
                                               precision, starts, loss, bursts);
        return std::pair(found.shift, found.gain);
      },
      "bounds"_a, "t"_a, "away"_a, "distance"_a, "sigma"_a, "nlos_odds"_a, "share"_a, "weight"_a,
      "precision"_a, "starts"_a, "loss"_a, "bursts"_a);

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
        return told(search_heights(users, all, loss, most_above, most));
      },
      "frames"_a, "sigma"_a, "free"_a, "pairs"_a, "loss"_a, "most_above"_a, "most"_a);

  m.def(
      "range_residual",
      [](const UserPose& i, const Vector3& o_i, const UserPose& j, const Vector3& o_j, double measured) {
        Eigen::Matrix<double, 1, 2 * kUserColumns> row;
        const double residual = range_residual(i, o_i, j, o_j, measured, &row);
        return std::pair(residual, row);
      },
      "i"_a, "o_i"_a, "j"_a, "o_j"_a, "measured"_a);

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
