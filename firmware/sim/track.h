// Where an antenna is: straight lines between given places, at rest before the first and after the last.
#pragma once

#include <array>
#include <vector>

#include "firmware/sim/time.h"

namespace air {

using Position = std::array<double, 3>;  // m

double distance(const Position& a, const Position& b);  // m

class Track {
 public:
  // In the order of time.
  void add(Femto t, const Position& position);

  bool empty() const { return knots_.empty(); }
  Position at(Femto t) const;  // there must be a place

 private:
  struct Knot {
    Femto t;
    Position position;
  };

  std::vector<Knot> knots_;
};

}  // namespace air
