#include "factors/nlos_bursts.h"
#include "tests/cpp/check.h"

using namespace synchronizar;

namespace {

const NlosMixture kLoss{1.0, 0.002};
const Bursts kBursts{0.1, 1.0, 0.7, 0.2};
constexpr double kTypicalOdds = 0.1 / 0.9;
constexpr double kSigma = 0.1;

BurstOdds judge(const Column& whitened, double dt) {
  const Eigen::Index n = whitened.size();
  const Column t = Column::LinSpaced(n, 0.0, dt * static_cast<double>(n - 1));
  return burst_nlos_odds(t, whitened, Column::Constant(n, kSigma), Column::Constant(n, kTypicalOdds), kLoss,
                         kBursts);
}

// The probability that the loss gives range k with the odds that the chain speaks for.
double nlos(const BurstOdds& verdict, const Column& whitened, Eigen::Index k) {
  return 1.0 - kLoss.inlier_probability(whitened[k], {kSigma, verdict.nlos_odds[k]});
}

void a_burst_among_clean_ranges_is_found() {
  Column e = Column::Constant(60, -0.2);
  e.segment(25, 10).setConstant(-4.0);
  const BurstOdds verdict = judge(e, 0.1);
  for (Eigen::Index k = 0; k < 60; ++k) {
    const bool in_burst = k >= 25 && k < 35;
    CHECK(in_burst == (nlos(verdict, e, k) > 0.5));
  }
}

void a_range_is_more_suspect_inside_a_burst_than_among_honest_neighbours() {
  Column lone = Column::Zero(41), inside = Column::Zero(41);
  inside.segment(15, 11).setConstant(-4.0);
  lone[20] = inside[20] = -2.5;
  CHECK(nlos(judge(lone, 0.1), lone, 20) < 0.4);
  CHECK(nlos(judge(inside, 0.1), inside, 20) > 0.9);
}

void ranges_that_lie_long_apart_do_not_speak_for_each_other() {
  const Column pair = Column::Constant(2, -2.5), one = Column::Constant(1, -2.5);
  const double alone = nlos(judge(one, 1.0), one, 0);
  CHECK_NEAR(nlos(judge(pair, 1e6), pair, 0), alone, 1e-4);
  CHECK(nlos(judge(pair, 0.1), pair, 0) > alone + 0.05);
  CHECK_NEAR(judge(pair, 1e6).cost, 2.0 * judge(one, 1.0).cost, 1e-4);
}

void a_chain_of_nothing_costs_nothing() {
  const BurstOdds verdict = burst_nlos_odds(Column(0), Column(0), Column(0), Column(0), kLoss, kBursts);
  CHECK(verdict.nlos_odds.size() == 0);
  CHECK_NEAR(verdict.cost, 0.0, 0.0);
}

void a_chain_of_any_length_stays_finite() {
  for (const double e : {0.0, -2.0, -40.0, 40.0}) {
    const Eigen::Index n = 200000;
    const Column whitened = Column::Constant(n, e);
    const BurstOdds verdict = judge(whitened, 0.01);
    CHECK(verdict.nlos_odds.allFinite());
    CHECK(std::isfinite(verdict.cost));
    CHECK_NEAR(verdict.nlos_odds[n / 2] / verdict.nlos_odds[n / 2 + 100], 1.0, 1e-3);
  }
}

void ranges_of_one_moment_that_are_all_late_by_far_give_numbers() {
  for (const double e : {-10.0, -40.0, -1000.0}) {
    const Column whitened = Column::Constant(20, e);
    const BurstOdds verdict = judge(whitened, 0.0);
    CHECK(verdict.nlos_odds.allFinite());
    CHECK(std::isfinite(verdict.cost));
    for (Eigen::Index k = 0; k < 20; ++k) CHECK(nlos(verdict, whitened, k) > 0.99);
  }
}

void neighbours_say_no_less_of_a_range_that_is_later_still() {
  for (const double e : {-4.0, -7.0, -10.0, -20.0, -50.0}) {
    Column whitened = Column::Zero(31);
    whitened.segment(10, 11).setConstant(e);
    CHECK(judge(whitened, 0.1).nlos_odds[15] > 1.0);
  }
}

}  // namespace

int main() {
  a_burst_among_clean_ranges_is_found();
  a_range_is_more_suspect_inside_a_burst_than_among_honest_neighbours();
  ranges_that_lie_long_apart_do_not_speak_for_each_other();
  a_chain_of_nothing_costs_nothing();
  a_chain_of_any_length_stays_finite();
  ranges_of_one_moment_that_are_all_late_by_far_give_numbers();
  neighbours_say_no_less_of_a_range_that_is_later_still();
  return check::verdict();
}
