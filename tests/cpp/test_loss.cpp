#include "factors/loss.h"
#include "tests/cpp/check.h"

using namespace synchronizar;

namespace {

const RangeTraits kRange{0.1, 0.25};
const double kErrors[] = {-30.0, -6.0, -3.0, -2.0, -1.0, -0.1, 0.1, 1.0, 2.0, 3.0, 6.0, 30.0};

template <class Visit>
void for_each_loss(Visit visit) {
  visit(Squared{});
  visit(Huber{});
  visit(Cauchy{});
  visit(GemanMcClure{});
  visit(NlosMixture{1.0, 0.002});
}

void a_perfect_range_costs_nothing() {
  for_each_loss([](const auto& loss) {
    const LossValue value = loss(0.0, kRange);
    CHECK_NEAR(value.rho, 0.0, 0.0);
    CHECK_NEAR(value.weight, 1.0, 1e-3);
    CHECK_NEAR(value.curvature, value.weight, 0.0);
  });
}

void weight_and_curvature_are_derivatives_of_the_cost() {
  for_each_loss([](const auto& loss) {
    for (const double e : kErrors) {
      constexpr double h = 1e-3;
      const auto derivative = [&](auto f) {
        return (f(e - 2 * h) - 8 * f(e - h) + 8 * f(e + h) - f(e + 2 * h)) / (12 * h);
      };
      const LossValue value = loss(e, kRange);
      CHECK_NEAR(value.weight * e, derivative([&](double x) { return loss(x, kRange).rho; }), 1e-9);
      CHECK_NEAR(value.curvature, derivative([&](double x) { return loss(x, kRange).weight * x; }), 1e-9);
    }
  });
}

void a_larger_error_never_costs_less() {
  for_each_loss([](const auto& loss) {
    for (double e = 0.0; e < 30.0; e += 0.1) {
      for (const double side : {-1.0, 1.0}) {
        CHECK(loss(side * (e + 0.1), kRange).rho > loss(side * e, kRange).rho);
        CHECK(loss(side * e, kRange).weight >= 0.0);
      }
    }
  });
}

void values_by_hand() {
  CHECK_NEAR(Squared{}(3.0, kRange).rho, 4.5, 0.0);
  CHECK_NEAR(Huber{2.0}(-4.0, kRange).rho, 6.0, 0.0);
  CHECK_NEAR(Huber{2.0}(-4.0, kRange).weight, 0.5, 0.0);
  CHECK_NEAR(Cauchy{2.0}(2.0, kRange).rho, 2.0 * std::log(2.0), 1e-15);
  CHECK_NEAR(Cauchy{2.0}(2.0, kRange).weight, 0.5, 1e-15);
  CHECK_NEAR(GemanMcClure{3.0}(3.0, kRange).rho, 2.25, 1e-15);
  CHECK_NEAR(GemanMcClure{3.0}(3.0, kRange).weight, 0.25, 1e-15);
}

// Of an honest range the density is that of a normal distribution, of a late one that of a half Cauchy.
void the_late_cost_is_the_mixtures_negative_logarithm() {
  const double pi = std::acos(-1.0);
  const NlosMixture loss{1.5, 0.002};
  for (const double e : kErrors) {
    const double odds = e < 0.0 ? kRange.nlos_odds : loss.early_odds;
    const auto inlier = [&](double x) {
      return std::exp(-0.5 * x * x) / (std::sqrt(2.0 * pi) * kRange.sigma);
    };
    const auto stray = [&](double x) {
      return 2.0 / (pi * loss.scale * (1.0 + std::pow(x * kRange.sigma / loss.scale, 2)));
    };
    const double expected = std::log((inlier(0.0) + odds * stray(0.0)) / (inlier(e) + odds * stray(e)));
    CHECK_NEAR(loss(e, kRange).rho, expected, 1e-12);
    CHECK_NEAR(loss.inlier_probability(e, kRange), inlier(e) / (inlier(e) + odds * stray(e)), 1e-12);
  }
}

void what_is_late_stops_to_matter_long_before_what_is_early() {
  const NlosMixture loss{1.0, 0.002};
  CHECK(loss(-3.0, kRange).weight < 0.5);
  CHECK(loss(3.0, kRange).weight > 0.9);
  CHECK(loss(5.0, kRange).weight < 0.5);
}

void a_range_that_cannot_be_late_is_squared() {
  const NlosMixture loss{1.0, 0.0};
  for (const double e : {-1e3, -45.0, -5.0, -0.1, 0.1, 5.0, 45.0, 1e3}) {
    const LossValue value = loss(e, {0.1, 0.0});
    CHECK_NEAR(value.rho, 0.5 * e * e, 1e-9);
    CHECK_NEAR(value.weight, 1.0, 1e-9);
    CHECK_NEAR(value.curvature, 1.0, 1e-9);
    CHECK_NEAR(loss.inlier_probability(e, {0.1, 0.0}), 1.0, 0.0);
  }
}

void annealing_widens_the_loss_and_keeps_its_parabola() {
  for_each_loss([](const auto& loss) {
    for (const double mu : {1.0, 3.0, 100.0}) {
      const LossValue value = annealed(loss, mu, -6.0, kRange), inside = loss(-6.0 / mu, kRange);
      CHECK_NEAR(value.rho, mu * mu * inside.rho, 1e-12);
      CHECK_NEAR(value.weight, inside.weight, 0.0);
      CHECK_NEAR(value.curvature, inside.curvature, 0.0);
      CHECK_NEAR(annealed(loss, mu, -1e-2, kRange).rho, loss(-1e-2, kRange).rho, 1e-8);
    }
  });
}

}  // namespace

int main() {
  a_perfect_range_costs_nothing();
  weight_and_curvature_are_derivatives_of_the_cost();
  a_larger_error_never_costs_less();
  values_by_hand();
  the_late_cost_is_the_mixtures_negative_logarithm();
  what_is_late_stops_to_matter_long_before_what_is_early();
  a_range_that_cannot_be_late_is_squared();
  annealing_widens_the_loss_and_keeps_its_parabola();
  return check::verdict();
}
