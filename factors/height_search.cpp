#include "factors/height_search.h"

#include <algorithm>
#include <cmath>
#include <random>

namespace synchronizar {
namespace {

using std::size_t;

constexpr double kFinest = 0.05;  // m, the tables' step
constexpr int kMostSteps = 400;   // up or down from 0; where more are needed the step is larger
constexpr double kReach = 4.0;    // sigmas of the prior within which heights are searched
constexpr int kNear = 2;          // steps: optima that are no further apart are one
constexpr int kStarts = 64;
constexpr int kMostSweeps = 50;
constexpr int kMostRanges = 64;  // of a pair in its table, evenly chosen; they stand for all

// A pair's cost at each difference in height, in steps from -`zero` to `zero`.
struct Table {
  int i, j;
  int zero;
  Column cost;
};

double reach_of(const HeightUser& user) {
  return user.free ? std::max(kReach * user.sigma, std::abs(user.pose.frame_height))
                   : std::abs(user.pose.frame_height);
}

double step_of(const std::vector<HeightUser>& users) {
  double reach = 0.0;
  for (const HeightUser& user : users) reach = std::max(reach, user.present ? reach_of(user) : 0.0);
  return std::max(kFinest, reach / kMostSteps);
}

// Heights in steps, and the most likely mean height (m) for them.
struct State {
  std::vector<int> at;
  double mean_height;
};

struct Problem {
  const std::vector<HeightUser>& users;
  double step_length;  // m
  std::vector<Table> tables;
  std::vector<std::vector<size_t>> tables_of;  // of each user

  int steps_of(size_t user) const { return static_cast<int>(std::ceil(reach_of(users[user]) / step_length)); }

  double prior(size_t user, int step, double mean_height) const {
    return users[user].present ? 0.5 * std::pow((step_length * step - mean_height) / users[user].sigma, 2)
                               : 0.0;
  }

  double mean_height(const std::vector<int>& at) const {
    double sum = 0.0, weights = 0.0;
    for (size_t u = 0; u < users.size(); ++u) {
      if (!users[u].present) continue;
      const double weight = 1.0 / (users[u].sigma * users[u].sigma);
      sum += weight * step_length * at[u];
      weights += weight;
    }
    return weights > 0.0 ? sum / weights : 0.0;
  }

  // The part of the cost that depends on user u's height, at `step`, given the other heights.
  double cost_at(size_t u, int step, const State& state) const {
    double sum = prior(u, step, state.mean_height);
    for (const size_t k : tables_of[u]) {
      const Table& table = tables[k];
      const auto i = static_cast<size_t>(table.i), j = static_cast<size_t>(table.j);
      const int difference = i == u ? step - state.at[j] : state.at[i] - step;
      sum += table.cost[difference + table.zero];
    }
    return sum;
  }

  double cost(const State& state) const {
    double sum = 0.0;
    for (size_t u = 0; u < users.size(); ++u) sum += prior(u, state.at[u], state.mean_height);
    for (const Table& t : tables) {
      sum += t.cost[state.at[static_cast<size_t>(t.i)] - state.at[static_cast<size_t>(t.j)] + t.zero];
    }
    return sum;
  }

  // Coordinate descent to the next local optimum, one table step at a time: a longer one could skip an
  // optimum.
  void descend(State& state) const {
    bool moved = true;
    for (int sweep = 0; sweep < kMostSweeps && moved; ++sweep) {
      moved = false;
      for (size_t u = 0; u < users.size(); ++u) {
        if (!users[u].free) continue;
        double least = cost_at(u, state.at[u], state);
        for (const int direction : {-1, 1}) {
          while (std::abs(state.at[u] + direction) <= steps_of(u)) {
            const double next = cost_at(u, state.at[u] + direction, state);
            if (next >= least - 1e-9) break;
            least = next;
            state.at[u] += direction;
            moved = true;
          }
        }
      }
      state.mean_height = mean_height(state.at);
    }
  }
};

}  // namespace

std::vector<Heights> search_heights(const std::vector<HeightUser>& users,
                                    const std::vector<HeightPair>& pairs, const LossKind& loss,
                                    double most_above, int most) {
  Problem p{users, step_of(users), {}, std::vector<std::vector<size_t>>(users.size())};
  for (const HeightPair& pair : pairs) {
    const auto i = static_cast<size_t>(pair.i), j = static_cast<size_t>(pair.j);
    const int zero = p.steps_of(i) + p.steps_of(j);
    p.tables_of[i].push_back(p.tables.size());
    p.tables_of[j].push_back(p.tables.size());
    p.tables.push_back(
        {pair.i, pair.j, zero,
         pair.block->height_profile(users[i].pose, users[j].pose, loss, p.step_length, zero, kMostRanges)});
  }

  const auto nearest = [&](size_t u, double height) {
    const int reach = p.steps_of(u);
    return std::clamp(static_cast<int>(std::lround(height / p.step_length)), -reach, reach);
  };
  std::mt19937 random(1);  // a fixed draw: the same ranges give the same answer
  std::vector<State> optima;
  for (int start = 0; start < kStarts; ++start) {
    State state{std::vector<int>(users.size()), 0.0};
    for (size_t u = 0; u < users.size(); ++u) {
      const double drawn = users[u].sigma * std::normal_distribution<double>()(random);
      const double begin = users[u].pose.frame_height;
      state.at[u] = nearest(u, start == 0 || !users[u].free ? begin : start == 1 ? -begin : drawn);
    }
    state.mean_height = p.mean_height(state.at);
    p.descend(state);
    optima.push_back(state);
  }

  // Best first; neighbouring steps on a plateau are one optimum.
  std::sort(optima.begin(), optima.end(),
            [&](const State& a, const State& b) { return p.cost(a) < p.cost(b); });
  const double limit = p.cost(optima.front()) + most_above;
  std::vector<State> kept;
  for (const State& state : optima) {
    const auto near = [&](const State& other) {
      for (size_t u = 0; u < users.size(); ++u) {
        if (std::abs(other.at[u] - state.at[u]) > kNear) return false;
      }
      return true;
    };
    if (p.cost(state) <= limit && std::none_of(kept.begin(), kept.end(), near)) kept.push_back(state);
  }
  std::vector<Heights> found;
  for (const State& state : kept) {
    Heights heights{Column(static_cast<Eigen::Index>(users.size())), p.cost(state)};
    for (size_t u = 0; u < users.size(); ++u) {
      const double height = users[u].free ? p.step_length * state.at[u] : users[u].pose.frame_height;
      heights.height[static_cast<Eigen::Index>(u)] = height;
    }
    found.push_back(std::move(heights));
  }
  if (found.size() > static_cast<size_t>(most)) found.resize(static_cast<size_t>(most));
  return found;
}

}  // namespace synchronizar
