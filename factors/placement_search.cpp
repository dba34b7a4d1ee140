#include "factors/placement_search.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <random>

#include "factors/pair_sums.h"
#include "factors/vectorised.h"

namespace synchronizar {
namespace {

using FloatArray = Eigen::ArrayXf;
using std::size_t;

constexpr double kPi = 3.141592653589793;
constexpr int kCoarseRanges = 64;     // ranges that score a point of the grid
constexpr int kPairs = 32;            // pairs of ranges whose spheres are intersected at each yaw and height
constexpr int kBestOfYaw = 4;         // points kept at each yaw and height
constexpr int kExtentPoints = 8;      // antennas by which placements are compared
constexpr int kMostHeights = 40;      // above 0, and below
constexpr double kHeightStep = 0.75;  // m, of the grid over heights within the prior

constexpr double kWide = 8.0;  // sigmas: the scale of the first refinement's loss
constexpr int kWideSteps = 5;
constexpr int kSteps = 10;
constexpr double kInQuestion = 4.0;  // times `most_cost_above`, kept after the first refinement
constexpr int kLeastYaws = 36;
constexpr int kMostYaws = 360;

struct Problem {
  const Points& known;
  const Points& own;
  const Column& measured;
  const Column& sigma;
  const Column& nlos_odds;
  const SearchOptions& options;
};

std::vector<int> even_selection(int of, int at_most) {
  const int n = std::min(of, at_most);
  std::vector<int> out(static_cast<size_t>(n));
  for (int k = 0; k < n; ++k) {
    out[static_cast<size_t>(k)] = static_cast<int>((2 * std::int64_t{k} + 1) * of / (2 * std::int64_t{n}));
  }
  return out;
}

// ---- the grid ----

struct Scored {
  double x, y, z, yaw, score;
};

// Sorts the candidates by `key`, best first, and keeps the best distinct ones, at most `at_most`: a candidate
// whose `extent` points are all within `distance` (m) of a better one's is the same.
template <class Candidate, class Key>
void keep_distinct(std::vector<Candidate>& candidates, const Points& extent, double distance, size_t at_most,
                   Key key) {
  std::sort(candidates.begin(), candidates.end(),
            [&](const Candidate& a, const Candidate& b) { return key(a) < key(b); });
  std::vector<Candidate> kept;
  std::vector<Points> places;
  Points place(extent.rows(), 3);
  for (const Candidate& c : candidates) {
    const CommonFromLocal common_from_user({c.x, c.y, c.yaw, c.z});
    for (Eigen::Index n = 0; n < extent.rows(); ++n) place.row(n) = common_from_user(extent.row(n));
    const bool is_new = std::none_of(places.begin(), places.end(), [&](const Points& other) {
      return (place - other).rowwise().squaredNorm().maxCoeff() < distance * distance;
    });
    if (!is_new) continue;
    kept.push_back(c);
    places.push_back(place);
    if (kept.size() == at_most) break;
  }
  candidates = std::move(kept);
}

// The same at one yaw and height, where all antennas move alike: compares origins.
void keep_best_of_yaw(std::vector<Scored>& candidates, double distance) {
  std::sort(candidates.begin(), candidates.end(),
            [](const Scored& a, const Scored& b) { return a.score < b.score; });
  size_t kept = 0;
  for (size_t k = 0; k < candidates.size() && kept < kBestOfYaw; ++k) {
    const Scored c = candidates[k];
    const auto near = [&](const Scored& other) {
      return std::hypot(c.x - other.x, c.y - other.y) < distance;
    };
    if (std::none_of(candidates.begin(), candidates.begin() + static_cast<std::ptrdiff_t>(kept), near)) {
      candidates[kept++] = c;
    }
  }
  candidates.resize(kept);
}

// The ranges that score the grid, as arrays of floats, which are precise enough for a start.
struct Coarse {
  FloatArray cx, cy, cz, qx, qy, qz, d;
  FloatArray mx, my, mz, dz2;  // centres of the spheres at this yaw, and (z - mz)^2 at this height

  Coarse(const Problem& p, const std::vector<int>& pick) {
    const auto n = static_cast<Eigen::Index>(pick.size());
    for (FloatArray* a : {&cx, &cy, &cz, &qx, &qy, &qz, &d}) a->resize(n);
    for (Eigen::Index k = 0; k < n; ++k) {
      const int r = pick[static_cast<size_t>(k)];
      cx[k] = static_cast<float>(p.known(r, 0));
      cy[k] = static_cast<float>(p.known(r, 1));
      cz[k] = static_cast<float>(p.known(r, 2));
      qx[k] = static_cast<float>(p.own(r, 0));
      qy[k] = static_cast<float>(p.own(r, 1));
      qz[k] = static_cast<float>(p.own(r, 2));
      d[k] = static_cast<float>(p.measured[r]);
    }
    mz = cz - qz;
  }

  void set_yaw(double yaw) {
    const auto c = static_cast<float>(std::cos(yaw)), s = static_cast<float>(std::sin(yaw));
    mx = cx - c * qx + s * qy;
    my = cy - s * qx - c * qy;
  }

  void set_height(double z) { dz2 = (static_cast<float>(z) - mz).square(); }

  // The two intersections of the spheres of ranges a and b at the set yaw and height; where these do not
  // meet, the point on the line through their centres that is nearest to both.
  std::array<std::array<float, 2>, 2> meet(int a, int b, int turn) const {
    const auto circle = [&](int n) { return std::sqrt(std::max(d[n] * d[n] - dz2[n], 0.0F)); };
    const float ra = circle(a), rb = circle(b);
    float ux = mx[b] - mx[a], uy = my[b] - my[a];
    const float between = std::hypot(ux, uy);
    if (between < 1e-3F) {  // one circle: any bearing will do
      const float bearing = 2.3999632F * static_cast<float>(turn);
      const float x = ra * std::cos(bearing), y = ra * std::sin(bearing);
      return {{{mx[a] + x, my[a] + y}, {mx[a] - x, my[a] - y}}};
    }
    ux /= between;
    uy /= between;
    const float along = (between * between + ra * ra - rb * rb) / (2.0F * between);
    const float h = std::sqrt(std::max(ra * ra - along * along, 0.0F));
    const float on = std::clamp(along, -ra, ra);
    return {{{mx[a] + on * ux - h * uy, my[a] + on * uy + h * ux},
             {mx[a] + on * ux + h * uy, my[a] + on * uy - h * ux}}};
  }
};

// The score of a place at the yaw and height that are set: Geman-McClure with the given scale (m), summed.
struct Place {
  float x, y, score;
};

SYNCHRONIZAR_INLINE void score_places(const Coarse& ranges, float scale, std::vector<Place>& places) {
  constexpr Eigen::Index kLanes = 16;
  const float *mx = ranges.mx.data(), *my = ranges.my.data(), *dz2 = ranges.dz2.data(), *d = ranges.d.data();
  const Eigen::Index n = ranges.d.size(), whole = n / kLanes * kLanes;
  const float scale2 = scale * scale;
  const auto loss = [&](const Place& at, Eigen::Index k) {
    const float dx = mx[k] - at.x, dy = my[k] - at.y, e = std::sqrt(dx * dx + dy * dy + dz2[k]) - d[k];
    return e * e / (e * e + scale2);
  };
  for (Place& at : places) {
    // NOLINTNEXTLINE(modernize-avoid-c-arrays): what a loop without branches reads and writes.
    float lanes[kLanes] = {};
    for (Eigen::Index k = 0; k < whole; k += kLanes) {
      for (Eigen::Index l = 0; l < kLanes; ++l) lanes[l] += loss(at, k + l);
    }
    at.score = 0.0F;
    for (const float of_lane : lanes) at.score += of_lane;
    for (Eigen::Index k = whole; k < n; ++k) at.score += loss(at, k);
  }
}

SYNCHRONIZAR_AVX2 void score_by_avx2(const Coarse& ranges, float scale, std::vector<Place>& places) {
  score_places(ranges, scale, places);
}

void score(const Coarse& ranges, float scale, std::vector<Place>& places) {
  has_avx2() ? score_by_avx2(ranges, scale, places) : score_places(ranges, scale, places);
}

// Heights within 2 sigma of the prior, the most likely first.
std::vector<double> heights(double sigma, double longest_range) {
  std::vector<double> out{0.0};
  const double reach = std::min(2.0 * sigma, longest_range);
  const double step = std::max(kHeightStep, reach / kMostHeights);
  for (int k = 1; k <= static_cast<int>(reach / step); ++k) {
    out.push_back(step * k);
    out.push_back(-step * k);
  }
  return out;
}

std::vector<Scored> search_grid(const Problem& p, const Points& extent) {
  const std::vector<int> pick = even_selection(static_cast<int>(p.measured.size()), kCoarseRanges);
  Coarse ranges(p, pick);
  const int n = static_cast<int>(pick.size());

  const double reach = std::sqrt(static_cast<double>(
      ((ranges.qx - ranges.qx.mean()).square() + (ranges.qy - ranges.qy.mean()).square()).mean()));
  const double noise = p.sigma.mean();
  // The yaw step is such that the grid's error, half a step at the rms antenna, is below the scale of the
  // score.
  const int yaws = p.options.has_yaw ? std::clamp(static_cast<int>(std::ceil(kPi * reach / (3.0 * noise))),
                                                  kLeastYaws, kMostYaws)
                                     : 1;
  const auto scale =
      static_cast<float>(std::hypot(3.0 * noise, p.options.has_yaw ? kPi * reach / yaws : 0.0));

  std::mt19937 random(1);  // a fixed draw: the same ranges give the same answer
  std::vector<std::array<int, 2>> pairs(kPairs);
  for (auto& pair : pairs) {
    pair[0] = static_cast<int>(random() % static_cast<unsigned>(n));
    pair[1] = static_cast<int>(random() % static_cast<unsigned>(n));
  }

  const std::vector<double> open_heights = heights(p.options.height_sigma, p.measured.maxCoeff());
  std::vector<Scored> found, here;
  std::vector<Place> places;
  for (int k = 0; k < yaws; ++k) {
    const double yaw = 2.0 * kPi * k / yaws - kPi * (p.options.has_yaw ? 1.0 : 0.0);
    ranges.set_yaw(yaw);
    for (const double z : open_heights) {
      ranges.set_height(z);
      places.clear();
      for (int m = 0; m < kPairs; ++m) {
        const auto& pair = pairs[static_cast<size_t>(m)];
        for (const auto& xy : ranges.meet(pair[0], pair[1], m)) places.push_back({xy[0], xy[1], 0.0F});
      }
      score(ranges, scale, places);
      here.clear();
      for (const Place& at : places) here.push_back({at.x, at.y, z, yaw, at.score});
      keep_best_of_yaw(here, 2.0 * scale);
      found.insert(found.end(), here.begin(), here.end());
    }
  }
  keep_distinct(found, extent, 2.0 * scale, static_cast<size_t>(p.options.most_candidates),
                [](const Scored& s) { return s.score; });
  return found;
}

// ---- the refinement ----

double height_cost(double z, double sigma) { return 0.5 * z * z / (sigma * sigma); }

// Some ranges of the user, who is i; the known points are j.
struct Ranges {
  pair_sums::Columns columns;
  Eigen::ArrayXd late;
  pair_sums::Place origin{UserPose{}};

  Ranges(const Problem& p, const std::vector<int>& pick)
      : columns({static_cast<Eigen::Index>(pick.size())}), late(Eigen::ArrayXd::Zero(columns.rows())) {
    const auto all = Eigen::all;
    const Column sigma = p.sigma(pick);
    columns.fill(0, p.own(pick, all), p.known(pick, all), p.measured(pick), sigma);
    columns.fill_late(0, sigma, p.nlos_odds(pick), p.options.loss, late);
  }

  pair_sums::Sums sums(const pair_sums::Place& at, const NlosMixture& loss) const {
    return pair_sums::reweighted(columns, 0, at, origin, loss, late);
  }
  pair_sums::Sums sums(const pair_sums::Place& at, const GemanMcClure& loss) const {
    return pair_sums::reweighted(columns, 0, at, origin, loss);
  }

  double cost(const Placement& at, const SearchOptions& options) const {
    return height_cost(at.z, options.height_sigma) +
           pair_sums::nlos_mixture_cost(columns, 0, place_of(at), origin, options.loss, 1.0, late);
  }

  static pair_sums::Place place_of(const Placement& at) {
    return pair_sums::Place(UserPose{at.x, at.y, at.yaw, at.z});
  }
};

// Levenberg-Marquardt on (x, y, z, yaw), with yaw about `centroid`, the mean of the extent points, where it
// is least coupled with the position.
template <class Kind>
void refine(const Ranges& ranges, const Kind& loss, const SearchOptions& options, const Vector3& centroid,
            int steps, Placement& at) {
  constexpr double kGain = 1e-3;  // of the cost: stops at a smaller gain
  double damping = 1e-3;
  const double height_weight = 1.0 / (options.height_sigma * options.height_sigma);
  pair_sums::Sums here = ranges.sums(Ranges::place_of(at), loss);
  at.cost = here.cost + height_cost(at.z, options.height_sigma);
  for (int step = 0; step < steps; ++step) {
    const CommonFromLocal common_from_user({at.x, at.y, at.yaw, at.z});
    const Vector3 pivot = common_from_user(centroid);
    const Vector3 arm = pivot - common_from_user.origin;
    Eigen::Matrix4d about_origin, about_pivot = Eigen::Matrix4d::Identity();
    Eigen::Vector4d gradient;
    for (size_t a = 0; a < 4; ++a) {
      const auto row = static_cast<Eigen::Index>(a);
      gradient[row] = here.gradient[a];
      for (size_t b = a; b < 4; ++b) {
        const auto column = static_cast<Eigen::Index>(b);
        about_origin(row, column) = about_origin(column, row) = here.squares[a][b];
      }
    }
    about_pivot(0, 3) = arm.y();
    about_pivot(1, 3) = -arm.x();
    if (!options.has_yaw) about_pivot.col(3).setZero();
    Eigen::Matrix4d H = about_pivot.transpose() * about_origin * about_pivot;
    Eigen::Vector4d g = about_pivot.transpose() * gradient;
    H(2, 2) += height_weight;
    g[2] += height_weight * at.z;
    bool moved = false;
    for (int attempt = 0; attempt < 4 && !moved; ++attempt) {
      Eigen::Matrix4d damped = H;
      damped.diagonal() += damping * H.diagonal();
      damped.diagonal().array() += 1e-9;
      const Eigen::Vector4d delta = -damped.ldlt().solve(g);
      Placement next{0.0, 0.0, 0.0, at.yaw + delta[3], 0.0};
      const Vector3 origin = pivot + delta.head<3>() - CommonFromLocal({0.0, 0.0, next.yaw, 0.0})(centroid);
      next.x = origin.x();
      next.y = origin.y();
      next.z = origin.z();
      const pair_sums::Sums there = ranges.sums(Ranges::place_of(next), loss);
      next.cost = there.cost + height_cost(next.z, options.height_sigma);
      moved = next.cost < at.cost;
      if (!moved) {
        damping = std::max(damping * 10.0, 1e-3);
        continue;
      }
      damping *= 0.1;
      const double gain = at.cost - next.cost;
      at = next;
      here = there;
      if (gain < kGain) return;
    }
    if (!moved) return;
  }
}

}  // namespace

std::vector<Placement> search_placements(const Points& known, const Points& own, const Column& measured,
                                         const Column& sigma, const Column& nlos_odds,
                                         const SearchOptions& options) {
  const Problem p{known, own, measured, sigma, nlos_odds, options};
  const int n = static_cast<int>(measured.size());

  const std::vector<int> extent_rows = even_selection(n, kExtentPoints);
  Points extent(static_cast<Eigen::Index>(extent_rows.size()), 3);
  for (size_t k = 0; k < extent_rows.size(); ++k)
    extent.row(static_cast<Eigen::Index>(k)) = own.row(extent_rows[k]);
  const Vector3 centroid = extent.colwise().mean();

  std::vector<Placement> found;
  for (const Scored& start : search_grid(p, extent)) {
    found.push_back({start.x, start.y, start.z, start.yaw, 0.0});
  }
  const auto by_cost = [](const Placement& c) { return c.cost; };
  // Leaves out duplicates of better ones, and costs more than `above` over the best.
  const auto keep_good = [&](double above) {
    keep_distinct(found, extent, options.apart, found.size(), by_cost);
    const double most = found.front().cost + above;
    found.erase(std::find_if(found.begin(), found.end(), [&](const Placement& c) { return c.cost > most; }),
                found.end());
  };

  // First a few steps under a wide, cheap loss for all; then the given loss for those not excluded by their
  // cost.
  const Ranges few(p, even_selection(n, kCoarseRanges)), pick(p, even_selection(n, options.most_ranges));
  for (Placement& at : found) {
    refine(few, GemanMcClure{kWide}, options, centroid, kWideSteps, at);
    at.cost = pick.cost(at, options);
  }
  keep_good(kInQuestion * options.most_cost_above);
  for (Placement& at : found) refine(pick, options.loss, options, centroid, kSteps, at);

  const Ranges all(p, even_selection(n, n));
  for (Placement& at : found) {
    at.yaw = std::remainder(at.yaw, 2.0 * kPi);
    at.cost = all.cost(at, options);
  }
  keep_good(options.most_cost_above);
  return found;
}

}  // namespace synchronizar
