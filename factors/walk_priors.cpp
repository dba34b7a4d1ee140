#include "factors/walk_priors.h"

#include <cmath>
#include <utility>

#include "factors/gauss_newton.h"

namespace synchronizar {

namespace {

double height_of_origin(int user, const Walks& walks, const WalkStates& states) {
  const int begin = walks.first[user];
  return states.places(begin, 2) - std::exp(states.calibration(user, 0)) * walks.slam(begin, 2);
}

Vector3 shared_calibration(const WalkStates& states, const WalkNoise& noise) {
  Vector3 weight = noise.shared_sigma.cwiseAbs2().cwiseInverse(), sum = Vector3::Zero();
  for (Eigen::Index u = 0; u < states.calibration.rows(); ++u) {
    const Vector3 own = noise.device_sigma.row(u).cwiseAbs2().cwiseInverse();
    weight += own;
    sum += own.cwiseProduct(Vector3(states.calibration.row(u)));
  }
  return sum.cwiseQuotient(weight);
}

double mean_height(const Walks& walks, const WalkStates& states, const WalkNoise& noise) {
  double weight = 0.0, sum = 0.0;
  for (int u = 0; u < walks.users; ++u) {
    if (noise.surveyed[u]) continue;
    const double own = std::pow(noise.height_sigma[u], -2);
    weight += own;
    if (u != walks.reference) sum += own * height_of_origin(u, walks, states);
  }
  return sum / weight;
}

// The height at which a device is carried, and the information on it.
std::pair<double, double> own_height(int user, const Walks& walks, const WalkStates& states,
                                     const WalkNoise& noise) {
  const int begin = walks.first[user], count = walks.first[user + 1] - begin;
  const auto information = noise.level_information.segment(begin, count);
  const double sum = information.sum();
  return {sum > 0.0 ? information.dot(states.places.col(2).segment(begin, count)) / sum : 0.0, sum};
}

// A lasting error beside the one that it follows, over the 1 sigma of their difference.
double lasting_step(int which, const Walks& walks, const WalkStates& states, const WalkNoise& noise) {
  const int before = walks.follows[which];
  const double decay = walks.decay[which];
  const double off = states.lasting[which] - (before < 0 ? 0.0 : decay * states.lasting[before]);
  return off / (noise.lasting_sigma[which] * std::sqrt(1.0 - decay * decay));
}

void add_calibration_priors(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
                            const WalkNoise& noise) {
  const Where& shared_at = layout.shared_calibration();
  const Vector3 shared = shared_calibration(states, noise);
  const Vector3 of_shared = noise.shared_sigma.cwiseAbs2().cwiseInverse();
  system.add(shared_at, shared_at, Eigen::Matrix3d(of_shared.asDiagonal()));
  system.add_gradient(shared_at, Vector3(of_shared.cwiseProduct(shared)));
  for (int u = 0; u < layout.walks().users; ++u) {
    const Where& device = layout.device(u);
    const Vector3 own = noise.device_sigma.row(u).cwiseAbs2().cwiseInverse();
    const Vector3 pull = own.cwiseProduct(Vector3(states.calibration.row(u)) - shared);
    system.add(device, device, Eigen::Matrix3d(own.asDiagonal()));
    system.add(shared_at, shared_at, Eigen::Matrix3d(own.asDiagonal()));
    system.add(shared_at, device, Eigen::Matrix3d(-Eigen::Matrix3d(own.asDiagonal())));
    system.add_gradient(device, pull);
    system.add_gradient(shared_at, Vector3(-pull));
    const double of_bias = std::pow(noise.known_bias_sigma[u], -2);
    system.add(device, device, Eigen::Matrix3d(Vector3(0.0, of_bias, 0.0).asDiagonal()));
    system.add_gradient(device, Vector3(0.0, of_bias * states.calibration(u, 1), 0.0));
  }
}

// Of each first keyframe's place, and of the height of the origin, which is that of the first keyframe
// without scale times SLAM's: about where it was surveyed, or about the mean height.
void add_place_priors(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
                      const WalkNoise& noise) {
  const Walks& walks = layout.walks();
  const Where& mean_at = layout.mean_height();
  const double mean = mean_height(walks, states, noise);
  for (int u = 0; u < walks.users; ++u) {
    const double weight = std::pow(noise.height_sigma[u], -2);
    const bool fixed = u == walks.reference, by_itself = noise.surveyed[u];
    const double slope = weight * ((fixed ? 0.0 : height_of_origin(u, walks, states)) -
                                   (by_itself ? noise.about(u, 2) : mean));
    if (!by_itself) {
      system.add(mean_at, mean_at, OneByOne(weight));
      system.add_gradient(mean_at, OneByOne(-slope));
    }
    if (fixed) continue;
    const int first = walks.first[u];
    const auto off = states.places.row(first) - noise.about.row(u);
    const double in_plane = std::pow(noise.place_sigma[u], -2), in_yaw = std::pow(noise.yaw_sigma, -2);
    const Where& at = layout.keyframe(first);
    system.add(at, at, Eigen::Matrix4d(Eigen::Vector4d(in_plane, in_plane, weight, in_yaw).asDiagonal()));
    system.add_gradient(
        at, Eigen::Vector4d(in_plane * off[0], in_plane * off[1], slope, in_yaw * wrapped(off[3])));
    if (!by_itself) system.add(mean_at, at, Eigen::RowVector4d(0.0, 0.0, -weight, 0.0));
    const Where& device = layout.device(u);
    const double by_scale = -std::exp(states.calibration(u, 0)) * walks.slam(first, 2);
    system.add(device, device, OneByOne(weight * by_scale * by_scale));
    system.add_gradient(device, OneByOne(slope * by_scale));
    system.add(device, at, Eigen::RowVector4d(0.0, 0.0, weight * by_scale, 0.0));
    if (!by_itself) system.add(mean_at, device, OneByOne(-weight * by_scale));
  }
}

void add_level_priors(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
                      const WalkNoise& noise) {
  const Walks& walks = layout.walks();
  for (int u = 0; u < walks.users; ++u) {
    const Where& own_at = layout.own_height(u);
    const auto [own, sum] = own_height(u, walks, states, noise);
    // The variable of a device that is nowhere held to it needs a place in the matrix all the same.
    system.add(own_at, own_at, OneByOne(sum > 0.0 ? sum : 1.0));
    for (int n = walks.first[u]; n < walks.first[u + 1]; ++n) {
      const auto [at, by] = layout.height(n, states);
      const double information = noise.level_information[n],
                   slope = information * (states.places(n, 2) - own);
      system.add(at, at, OneByOne(by * by * information));
      system.add(own_at, at, OneByOne(-by * information));
      system.add_gradient(at, OneByOne(by * slope));
      system.add_gradient(own_at, OneByOne(-slope));
    }
  }
}

void add_lasting_priors(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
                        const WalkNoise& noise) {
  const Walks& walks = layout.walks();
  for (int v = 0; v < walks.follows.size(); ++v) {
    const Where& here = layout.lasting(v);
    const int before = walks.follows[v];
    const double decay = walks.decay[v];
    const double root = 1.0 / (noise.lasting_sigma[v] * std::sqrt(1.0 - decay * decay));
    const double pull = root * lasting_step(v, walks, states, noise);
    system.add(here, here, OneByOne(root * root));
    system.add_gradient(here, OneByOne(pull));
    if (before < 0) continue;
    const Where& there = layout.lasting(before);
    system.add(there, there, OneByOne(decay * decay * root * root));
    system.add(here, there, OneByOne(-decay * root * root));
    system.add_gradient(there, OneByOne(-decay * pull));
  }
}

}  // namespace

double prior_cost(const Walks& walks, const WalkStates& states, const WalkNoise& noise) {
  const double mean = mean_height(walks, states, noise);
  const Vector3 shared = shared_calibration(states, noise);
  double sum = shared.cwiseQuotient(noise.shared_sigma).squaredNorm();
  for (int u = 0; u < walks.users; ++u) {
    const Vector3 apart = Vector3(states.calibration.row(u)) - shared;
    sum += apart.cwiseQuotient(Vector3(noise.device_sigma.row(u))).squaredNorm();
    sum += std::pow(states.calibration(u, 1) / noise.known_bias_sigma[u], 2);
    const double height = u == walks.reference ? 0.0 : height_of_origin(u, walks, states);
    sum += std::pow((height - (noise.surveyed[u] ? noise.about(u, 2) : mean)) / noise.height_sigma[u], 2);
    const double own = own_height(u, walks, states, noise).first;
    for (int n = walks.first[u]; n < walks.first[u + 1]; ++n) {
      sum += noise.level_information[n] * std::pow(states.places(n, 2) - own, 2);
    }
    if (u == walks.reference) continue;
    const auto off = states.places.row(walks.first[u]) - noise.about.row(u);
    sum += (off[0] * off[0] + off[1] * off[1]) / (noise.place_sigma[u] * noise.place_sigma[u]);
    sum += std::pow(wrapped(off[3]) / noise.yaw_sigma, 2);
  }
  for (int v = 0; v < walks.follows.size(); ++v) sum += std::pow(lasting_step(v, walks, states, noise), 2);
  return 0.5 * sum;
}

void add_priors(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
                const WalkNoise& noise) {
  add_calibration_priors(system, layout, states, noise);
  add_place_priors(system, layout, states, noise);
  add_level_priors(system, layout, states, noise);
  add_lasting_priors(system, layout, states, noise);
}

}  // namespace synchronizar
