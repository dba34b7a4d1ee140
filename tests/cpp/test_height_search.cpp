#include <algorithm>
#include <random>
#include <vector>

#include "factors/height_search.h"
#include "tests/cpp/check.h"

using namespace synchronizar;

namespace {

constexpr double kStep = 0.05;  // m, of the grid that heights are sought on
constexpr double kAbove = 20.0;
constexpr int kMost = 8;

UserPose at_height(double height) {
  UserPose pose{};
  pose.frame_height = height;
  return pose;
}

HeightUser user(double height, bool free) { return {at_height(height), 0.1, free, true}; }

// Walkers close to each other on the level, or bobbing, who all range to one another without noise; their
// frames are the common one but for their heights.
struct Walkers {
  std::vector<RangeBlock> blocks;
  std::vector<HeightPair> pairs;

  Walkers(unsigned seed, const std::vector<double>& heights, double bob) {
    constexpr int n = 50;
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> place(-0.4, 0.4);
    std::normal_distribution<double> up(0.0, 1.0);
    std::vector<Points> walks;
    for (size_t u = 0; u < heights.size(); ++u) {
      Points walk(n, 3);
      for (int k = 0; k < n; ++k) walk.row(k) << place(random), place(random), bob * up(random);
      walks.push_back(walk);
    }
    std::vector<std::pair<int, int>> ends;
    for (size_t i = 0; i < heights.size(); ++i) {
      for (size_t j = i + 1; j < heights.size(); ++j) {
        Points between = walks[i] - walks[j];
        between.col(2).array() += heights[i] - heights[j];
        blocks.emplace_back(walks[i], walks[j], between.rowwise().norm(), Column::Constant(n, 0.02),
                            Column::Constant(n, 0.25));
        ends.emplace_back(i, j);
      }
    }
    for (size_t k = 0; k < blocks.size(); ++k) pairs.push_back({ends[k].first, ends[k].second, &blocks[k]});
  }

  // By definition: all losses, and the heights' squared distances to the likeliest level.
  double cost(const std::vector<HeightUser>& users, const Column& height) const {
    double sum = 0.0, weights = 0.0, level = 0.0;
    for (const HeightPair& pair : pairs) {
      sum +=
          pair.block->cost(at_height(height[pair.i]), at_height(height[pair.j]), {NlosMixture{1.0, 0.002}});
    }
    for (size_t u = 0; u < users.size(); ++u) {
      const double weight = 1.0 / (users[u].sigma * users[u].sigma);
      level += weight * height[static_cast<Eigen::Index>(u)];
      weights += weight;
    }
    level /= weights;
    for (size_t u = 0; u < users.size(); ++u) {
      sum += 0.5 * std::pow((height[static_cast<Eigen::Index>(u)] - level) / users[u].sigma, 2);
    }
    return sum;
  }
};

void a_height_profile_is_the_cost_at_every_difference_in_height() {
  const Walkers walkers(1, {0.1, -0.2}, 0.3);
  const RangeBlock& block = walkers.blocks[0];
  constexpr int zero = 12;
  for (const double now : {0.0, 0.07, -0.4}) {
    const Column profile =
        block.height_profile(at_height(now), at_height(0.0), NlosMixture{1.0, 0.002}, kStep, zero, 1000);
    CHECK(profile.size() == 2 * zero + 1);
    for (int s = -zero; s <= zero; ++s) {
      const double expected =
          block.cost(at_height(0.3 + s * kStep), at_height(0.3), {NlosMixture{1.0, 0.002}});
      CHECK_NEAR(profile[s + zero], expected, 1e-9 * (1.0 + expected));
    }
  }
}

void a_profile_of_a_selection_stands_for_all() {
  const Walkers walkers(2, {0.1, -0.2}, 0.3);
  const auto profile = [&](int most) {
    return walkers.blocks[0].height_profile(at_height(0.0), at_height(0.0), Squared{}, kStep, 12, most);
  };
  const Column all = profile(50), some = profile(25);
  for (int k = 0; k < all.size(); ++k) CHECK_NEAR(some[k], all[k], 0.5 * all[k] + 1.0);
}

void the_best_of_the_whole_grid_is_found() {
  std::mt19937 random(3);
  std::normal_distribution<double> height(0.0, 0.12);
  for (unsigned n = 0; n < 20; ++n) {
    const Walkers walkers(n, {0.0, height(random), height(random)}, n % 2 ? 0.1 : 0.0);
    const std::vector<HeightUser> users{user(0.0, false), user(0.0, true), user(0.0, true)};
    const auto found = search_heights(users, walkers.pairs, NlosMixture{1.0, 0.002}, kAbove, kMost);
    double least = 1e9;
    for (int a = -8; a <= 8; ++a) {
      for (int b = -8; b <= 8; ++b) {
        least = std::min(least, walkers.cost(users, Eigen::Vector3d(0.0, kStep * a, kStep * b)));
      }
    }
    CHECK_NEAR(found[0].cost, least, 1e-6 * (1.0 + least));
    for (size_t k = 0; k < found.size(); ++k) {
      CHECK_NEAR(found[k].cost, walkers.cost(users, found[k].height), 1e-6 * (1.0 + found[k].cost));
      CHECK(k == 0 || found[k - 1].cost <= found[k].cost);
      CHECK(found[k].cost <= found[0].cost + kAbove);
    }
  }
}

void walkers_on_the_level_get_both_signs() {
  const Walkers walkers(4, {0.0, 0.25, -0.15}, 0.0);
  const auto found = search_heights({user(0.0, false), user(0.0, true), user(0.0, true)}, walkers.pairs,
                                    NlosMixture{1.0, 0.002}, kAbove, kMost);
  CHECK(found.size() >= 2);
  CHECK_NEAR(found[0].cost, found[1].cost, 1e-9);
  const double sign = found[0].height[1] > 0.0 ? 1.0 : -1.0;
  for (const auto& [k, side] : {std::pair(0, sign), std::pair(1, -sign)}) {
    CHECK_NEAR(found[static_cast<size_t>(k)].height[1], side * 0.25, 1e-9);
    CHECK_NEAR(found[static_cast<size_t>(k)].height[2], side * -0.15, 1e-9);
  }
}

void held_users_stay() {
  const Walkers walkers(5, {0.0, 0.2, 0.0}, 0.1);
  const auto found = search_heights({user(0.1, false), user(0.0, true), user(-0.35, false)}, walkers.pairs,
                                    NlosMixture{1.0, 0.002}, kAbove, kMost);
  for (const Heights& h : found) {
    CHECK_NEAR(h.height[0], 0.1, 1e-9);
    CHECK_NEAR(h.height[2], -0.35, 1e-9);
  }
}

void as_many_as_asked_for_and_the_same_each_time() {
  const Walkers walkers(6, {0.0, 0.25, -0.15}, 0.0);
  const std::vector<HeightUser> users{user(0.0, false), user(0.0, true), user(0.0, true)};
  const auto found = search_heights(users, walkers.pairs, NlosMixture{1.0, 0.002}, kAbove, kMost);
  const auto again = search_heights(users, walkers.pairs, NlosMixture{1.0, 0.002}, kAbove, kMost);
  CHECK(found.size() == again.size());
  for (size_t k = 0; k < found.size(); ++k) {
    CHECK_NEAR((found[k].height - again[k].height).norm(), 0.0, 0.0);
  }
  CHECK(search_heights(users, walkers.pairs, NlosMixture{1.0, 0.002}, kAbove, 1).size() == 1);
}

}  // namespace

int main() {
  a_height_profile_is_the_cost_at_every_difference_in_height();
  a_profile_of_a_selection_stands_for_all();
  the_best_of_the_whole_grid_is_found();
  walkers_on_the_level_get_both_signs();
  held_users_stay();
  as_many_as_asked_for_and_the_same_each_time();
  return check::verdict();
}
