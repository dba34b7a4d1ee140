// Neighbours in time among the ranges of each pair.
#include "factors/neighbours.h"

#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/tuple.h>

#include <tuple>

#include "bindings/bindings.h"
#include "bindings/checks.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

void bind_neighbours(nb::module_& m) {
  m.def(
      "neighbour_counts",
      [](const Numbers& bounds, const Column& t, double reach) {
        check_bounds(bounds, t.size());
        return neighbour_counts(bounds, t, reach);
      },
      "bounds"_a, "t"_a, "reach"_a);

  m.def(
      "neighbour_sums",
      [](const Numbers& bounds, const Column& t, const Numbers& link, const Column& score,
         const Column& weight, double gap, int most) {
        const auto n = t.size();
        check_bounds(bounds, n);
        require(link.size() == n && score.size() == n && weight.size() == n, "all columns must be (n,)");
        require(most > 0, "most must be positive");
        const NeighbourSums sums = neighbour_sums(bounds, t, link, score, weight, gap, most);
        return std::tuple(sums.squares, sums.weights, sums.product, sums.both);
      },
      "bounds"_a, "t"_a, "link"_a, "score"_a, "weight"_a, "gap"_a, "most"_a);
}

}  // namespace synchronizar
