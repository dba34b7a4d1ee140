// Heights that a search found, as Python gets them.
#pragma once

#include <utility>
#include <vector>

#include "factors/height_search.h"

namespace synchronizar {

// (k) the heights (m) and the cost of each.
inline std::vector<std::pair<Column, double>> heights_and_costs(const std::vector<Heights>& found) {
  std::vector<std::pair<Column, double>> out;
  for (const Heights& of : found) out.emplace_back(of.height, of.cost);
  return out;
}

}  // namespace synchronizar
