#include <algorithm>
#include <random>
#include <utility>

#include "factors/placement_search.h"
#include "tests/cpp/check.h"

using namespace synchronizar;

namespace {

const SearchOptions kPeople{0.15, true, NlosMixture{1.0, 0.002}, 0.5, 16, 128, 30.0};
const SearchOptions kRadio{3.0, false, NlosMixture{1.0, 0.002}, 0.5, 16, 128, 30.0};

CommonFromLocal common_from_user(const Placement& at) { return CommonFromLocal({at.x, at.y, at.yaw, at.z}); }

struct Scene {
  Points known, own;
  Placement truth;
  Column measured, sigma, nlos_odds;

  Scene(Points known_points, Points own_points, const Placement& at)
      : known(std::move(known_points)), own(std::move(own_points)), truth(at) {
    const Eigen::Index n = known.rows();
    measured.resize(n);
    for (Eigen::Index k = 0; k < n; ++k) {
      const Vector3 q = common_from_user(at)(own.row(k));
      measured[k] = (known.row(k).transpose() - q).norm();
    }
    sigma = Column::Constant(n, 0.1);
    nlos_odds = Column::Constant(n, 0.25);
  }

  std::vector<Placement> search(const SearchOptions& options) const {
    return search_placements(known, own, measured, sigma, nlos_odds, options);
  }

  // How far (m) the placement puts any antenna from where `other` puts it.
  double apart(const Placement& at, const Placement& other) const {
    double out = 0.0;
    for (Eigen::Index k = 0; k < own.rows(); ++k) {
      const Vector3 o = own.row(k);
      out = std::max(out, (common_from_user(at)(o) - common_from_user(other)(o)).norm());
    }
    return out;
  }

  double cost(const Placement& at, const SearchOptions& options) const {
    double sum = 0.5 * std::pow(at.z / options.height_sigma, 2);
    for (Eigen::Index k = 0; k < known.rows(); ++k) {
      const double distance = (known.row(k).transpose() - common_from_user(at)(own.row(k))).norm();
      sum += options.loss((distance - measured[k]) / sigma[k], {sigma[k], nlos_odds[k]}).rho;
    }
    return sum;
  }
};

// Somebody walks about at 1 m/s for 30 s, turning all the time.
Points wander(std::mt19937& random) {
  std::normal_distribution<double> turn(0.0, 0.4);
  Points out(100, 3);
  double x = 0.0, y = 0.0, heading = turn(random) * 8.0;
  for (int k = 0; k < 100; ++k) {
    heading += turn(random);
    x += 0.3 * std::cos(heading);
    y += 0.3 * std::sin(heading);
    out.row(k) << x, y, 1.2;
  }
  return out;
}

Points all_at(double x, double y, double z) { return Points(Vector3(x, y, z).transpose().replicate(100, 1)); }

void two_who_wander_are_placed() {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> yaw(-3.0, 3.0);
  for (int n = 0; n < 50; ++n) {
    const Points known = wander(random), own = wander(random);
    const Scene scene(known, own, {2.0, -3.0, 0.0, yaw(random), 0.0});
    const Placement best = scene.search(kPeople).front();
    CHECK_NEAR(scene.apart(best, scene.truth), 0.0, 1e-3);
    CHECK_NEAR(std::remainder(best.yaw - scene.truth.yaw, 2.0 * std::acos(-1.0)), 0.0, 1e-3);
  }
}

void two_in_five_ranges_may_be_late() {
  std::mt19937 random(2);
  std::uniform_real_distribution<double> detour(0.5, 4.0);
  for (int n = 0; n < 50; ++n) {
    const Points known = wander(random), own = wander(random);
    Scene scene(known, own, {2.0, -3.0, 0.0, 1.0, 0.0});
    for (int k = 0; k < 100; ++k) scene.measured[k] += k % 5 < 2 ? detour(random) : 0.0;
    CHECK_NEAR(scene.apart(scene.search(kPeople).front(), scene.truth), 0.0, 0.15);
  }
}

void a_user_on_a_line_has_a_mirror_image() {
  Points known(60, 3), own(60, 3);
  for (int k = 0; k < 60; ++k) {
    const double s = k / 59.0;
    known.row(k) << 8.0 * s, 0.0, 1.2;
    own.row(k) << 3.0 * s * s, 0.0, 1.2;  // at no steady pace, or there would be four
  }
  const Scene scene(known, own, {2.0, 3.0, 0.0, 0.7, 0.0});
  const auto found = scene.search(kPeople);
  CHECK(found.size() >= 2);
  CHECK_NEAR(found[0].cost, 0.0, 1e-3);
  CHECK_NEAR(found[1].cost, 0.0, 1e-3);
  const Placement mirrored{2.0, -3.0, 0.0, -0.7, 0.0};
  for (const Placement& image : {scene.truth, mirrored}) {
    CHECK_NEAR(std::min(scene.apart(found[0], image), scene.apart(found[1], image)), 0.0, 1e-2);
  }
}

void a_radio_and_its_mirror_image_in_height_are_found() {
  std::mt19937 random(3);
  const Scene scene(wander(random), all_at(0.0, 0.0, 0.0), {4.0, -2.0, 2.6, 0.0, 0.0});
  const auto found = scene.search(kRadio);
  CHECK(found.size() >= 2);
  CHECK_NEAR(found[0].z, 2.0 * 1.2 - 2.6, 2e-2);  // the nearer to the floor, where the prior is
  CHECK_NEAR(found[1].z, 2.6, 2e-2);
  for (const Placement& at : found) CHECK_NEAR(at.yaw, 0.0, 0.0);
}

void what_leaves_a_circle_gives_points_on_it() {
  const Scene many(all_at(1.0, 2.0, 1.2), all_at(0.5, 0.0, 1.2), {4.0, 6.0, 0.0, 1.0, 0.0});
  const Scene one(many.known.topRows(1), many.own.topRows(1), many.truth);
  for (const Scene& scene : {many, one}) {
    const auto found = scene.search(kPeople);
    CHECK(found.size() > 1);
    for (const Placement& at : found) CHECK_NEAR(at.cost, 0.0, 1e-2);
  }
}

void antennas_that_coincide_are_no_trouble() {
  const Scene scene(all_at(1.0, 2.0, 1.2), all_at(0.0, 0.0, 1.2), {1.0, 2.0, 0.0, 0.0, 0.0});
  const Placement best = scene.search(kPeople).front();
  CHECK_NEAR(best.x, 1.0, 2e-2);
  CHECK_NEAR(best.y, 2.0, 2e-2);
}

void placements_come_best_first_at_their_true_cost_and_the_same_each_time() {
  std::mt19937 random(4);
  std::normal_distribution<double> noise(0.0, 0.1);
  Points known = wander(random);
  known.col(2) = Column::LinSpaced(100, 1.2, 4.0);  // up a stair, so that the height is seen
  Scene scene(known, all_at(1.0, 0.0, 1.2), {2.0, -3.0, 0.3, 1.0, 0.0});
  for (double& d : scene.measured) d += noise(random);
  const auto found = scene.search(kPeople), again = scene.search(kPeople);
  CHECK(found.size() == again.size());
  CHECK(found[0].z > 0.05);
  for (size_t k = 0; k < found.size(); ++k) {
    CHECK_NEAR(found[k].cost, scene.cost(found[k], kPeople), 1e-9);
    CHECK(k == 0 || found[k - 1].cost <= found[k].cost);
    CHECK(found[k].cost <= found[0].cost + kPeople.most_cost_above);
    CHECK_NEAR(scene.apart(found[k], again[k]), 0.0, 0.0);
  }
}

}  // namespace

int main() {
  two_who_wander_are_placed();
  two_in_five_ranges_may_be_late();
  a_user_on_a_line_has_a_mirror_image();
  a_radio_and_its_mirror_image_in_height_are_found();
  what_leaves_a_circle_gives_points_on_it();
  antennas_that_coincide_are_no_trouble();
  placements_come_best_first_at_their_true_cost_and_the_same_each_time();
  return check::verdict();
}
