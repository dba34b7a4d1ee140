// Where an antenna is: straight lines between given places, at rest before the first and after the last.
#pragma once

#include <array>
#include <deque>

#include "firmware/sim/time.h"

namespace air {

using Position = std::array<double, 3>;  // m

double distance(const Position& a, const Position& b);  // m

class Track {
 public:
  // In the order of time.
  void add(Femto t, const Position& position);

  bool empty() const { return knots_.empty(); }
  Femto oldest() const { return knots_.front().t; }  // there must be a place, here and below
  Femto newest() const { return knots_.back().t; }
  // Places that are needed for nothing from t on.
  void forget_before(Femto t);
  Position at(Femto t) const;

 private:
  struct Knot {
    Femto t;
    Position position;
  };

  std::deque<Knot> knots_;
};

}  // namespace air
