// The losses of a range's residual.
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/tuple.h>

#include <cmath>
#include <tuple>
#include <utility>

#include "bindings/bindings.h"
#include "bindings/checks.h"
#include "factors/loss.h"
#include "factors/mixture_terms.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

namespace {

double positive(double parameter) {
  require(parameter > 0.0 && std::isfinite(parameter), "a loss's scale must be positive");
  return parameter;
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

void bind_losses(nb::module_& m) {
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

  m.def(
      "mixture_terms",
      [](const Column& whitened, const Column& sigma, const Column& nlos_odds, const NlosMixture& loss) {
        const auto n = whitened.size();
        require(sigma.size() == n && nlos_odds.size() == n, "all columns must be (n,)");
        MixtureTerms terms = mixture_terms(whitened, sigma, nlos_odds, loss);
        return std::tuple(std::move(terms.rho), std::move(terms.weight), std::move(terms.inlier_probability));
      },
      "whitened"_a, "sigma"_a, "nlos_odds"_a, "loss"_a);
}

}  // namespace synchronizar
