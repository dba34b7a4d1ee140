// The optimisation of frames whose SLAM is trusted, and the statistics of its residuals.
#include "factors/rigid_solver.h"

#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <limits>
#include <tuple>
#include <utility>
#include <vector>

#include "bindings/bindings.h"
#include "bindings/checks.h"
#include "bindings/heights.h"
#include "factors/residual_statistics.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

namespace {

void check_frames(const RigidSolver& solver, const Frames& frames) {
  require(frames.rows() == solver.users(), "frames must be (k, 4)");
}

}  // namespace

void bind_rigid_solver(nb::module_& m) {
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
            }
            check_sorted_in_pairs(first, t);
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
            return heights_and_costs(self.other_heights(frames, nlos_odds, most_above, most));
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
}

}  // namespace synchronizar
