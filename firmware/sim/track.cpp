#include "firmware/sim/track.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace air {

double distance(const Position& a, const Position& b) {
  return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

void Track::add(Femto t, const Position& position) {
  if (!empty() && t <= knots_.back().t) throw std::invalid_argument("a track's times must rise");
  knots_.push_back({t, position});
}

void Track::forget_before(Femto t) {
  while (knots_.size() > 1 && knots_[1].t <= t) knots_.pop_front();
}

Position Track::at(Femto t) const {
  const auto after = std::upper_bound(knots_.begin(), knots_.end(), t,
                                      [](Femto moment, const Knot& knot) { return moment < knot.t; });
  if (after == knots_.begin()) return after->position;
  const Knot& from = *(after - 1);
  if (after == knots_.end()) return from.position;
  const double share = static_cast<double>(t - from.t) / static_cast<double>(after->t - from.t);
  Position position{};
  for (std::size_t i = 0; i < position.size(); ++i)
    position[i] = from.position[i] + share * (after->position[i] - from.position[i]);
  return position;
}

}  // namespace air
