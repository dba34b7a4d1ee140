// The adjustment of tracks to each other.
#include "factors/adjustment.h"

#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>

#include <utility>

#include "bindings/bindings.h"
#include "bindings/checks.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

void bind_adjustment(nb::module_& m) {
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
}

}  // namespace synchronizar
