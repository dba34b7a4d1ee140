#include "factors/neighbours.h"

#include <algorithm>
#include <numeric>

namespace synchronizar {

Column neighbour_counts(const Numbers& bounds, const Column& t, double reach) {
  Column out(t.size());
  for (Eigen::Index p = 0; p + 1 < bounds.size(); ++p) {
    Eigen::Index first = bounds[p], end = bounds[p];
    for (Eigen::Index n = bounds[p]; n < bounds[p + 1]; ++n) {
      while (t[first] < t[n] - reach) ++first;
      while (end < bounds[p + 1] && t[end] <= t[n] + reach) ++end;
      out[n] = static_cast<double>(end - first);
    }
  }
  return out;
}

NeighbourSums neighbour_sums(const Numbers& bounds, const Column& t, const Numbers& link, const Column& score,
                             const Column& weight, double gap, int most) {
  const Eigen::Index pairs = bounds.size() - 1;
  NeighbourSums out{Column::Zero(pairs), Column::Zero(pairs)};
  std::vector<Eigen::Index> order;
  for (Eigen::Index p = 0; p < pairs; ++p) {
    const Eigen::Index begin = bounds[p], count = bounds[p + 1] - begin;
    out.squares[p] = score.segment(begin, count).squaredNorm();
    out.weights[p] = weight.segment(begin, count).squaredNorm();
    const double own = std::max(out.squares[p] / std::max(out.weights[p], 1e-9), 1e-9);
    order.resize(static_cast<size_t>(count));
    std::iota(order.begin(), order.end(), begin);
    std::sort(order.begin(), order.end(), [&](Eigen::Index a, Eigen::Index b) {
      return link[a] < link[b] || (link[a] == link[b] && a < b);
    });
    double product = 0.0;
    for (size_t a = 0; a < order.size(); ++a) {
      for (size_t b = a + 1; b < std::min(order.size(), a + static_cast<size_t>(most)); ++b) {
        const Eigen::Index n = order[a], m = order[b];
        if (link[m] != link[n] || !(t[m] - t[n] < gap)) break;
        product += score[n] * score[m];
        out.both += weight[n] * weight[m];
      }
    }
    out.product += product / own;
  }
  return out;
}

}  // namespace synchronizar
