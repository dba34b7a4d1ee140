#include "factors/walk_layout.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

namespace synchronizar {

WalkLayout::WalkLayout(Walks walks) : walks_(std::move(walks)) {
  const Eigen::Index count = walks_.first[walks_.users];
  user_.resize(count);
  keyframe_.resize(static_cast<size_t>(count));
  device_.resize(static_cast<size_t>(walks_.users));
  own_height_.resize(static_cast<size_t>(walks_.users));
  lasting_.resize(static_cast<size_t>(walks_.follows.size()));
  std::vector<int> moving, standing;
  for (int u = 0; u < walks_.users; ++u) {
    const int begin = walks_.first[u], end = walks_.first[u + 1];
    user_.segment(begin, end - begin).setConstant(u);
    for (int n = begin + (u == walks_.reference ? 1 : 0); n < end; ++n) {
      (end - begin > 1 ? moving : standing).push_back(n);
    }
  }
  place_moving(std::move(moving));
  place_border(standing);
  place_lasting();
  connect_all();
}

// Groups by time: a new one where a user would be in one twice.
void WalkLayout::place_moving(std::vector<int> keyframes) {
  std::sort(keyframes.begin(), keyframes.end(),
            [&](int a, int b) { return walks_.t[a] < walks_.t[b] || (walks_.t[a] == walks_.t[b] && a < b); });
  std::vector<int> last_group(static_cast<size_t>(walks_.users), -1);
  for (const int n : keyframes) {
    int& last = last_group[static_cast<size_t>(user_[n])];
    if (sizes_.empty() || last == static_cast<int>(sizes_.size()) - 1) sizes_.push_back(0);
    last = static_cast<int>(sizes_.size()) - 1;
    keyframe_[static_cast<size_t>(n)] = {last, sizes_.back()};
    sizes_.back() += 4;
  }
}

void WalkLayout::place_border(const std::vector<int>& standing) {
  sizes_.push_back(0);
  const auto in_border = [&](int size) {
    sizes_.back() += size;
    return Where{border(), sizes_.back() - size};
  };
  for (const int n : standing) keyframe_[static_cast<size_t>(n)] = in_border(4);
  for (Where& at : device_) at = in_border(3);
  shared_calibration_ = in_border(3);
  mean_height_ = in_border(1);
  for (int u = 0; u < walks_.users; ++u) {
    if (walks_.first[u + 1] - walks_.first[u] > 1) own_height_[static_cast<size_t>(u)] = in_border(1);
  }
}

// A lasting error is in the group of the later end of its first range.
void WalkLayout::place_lasting() {
  for (Eigen::Index n = 0; n < walks_.lasting.size(); ++n) {
    Where& at = lasting_[static_cast<size_t>(walks_.lasting[n])];
    if (at.group >= 0) continue;
    int group = -1;
    for (const int key : {walks_.keyframe_i[n], walks_.keyframe_j[n]}) {
      if (keyframe(key).group < border()) group = std::max(group, keyframe(key).group);
    }
    if (group < 0) group = border();
    at = {group, sizes_[static_cast<size_t>(group)]++};
  }
}

void WalkLayout::connect(const Where& a, const Where& b) {
  if (a.group < 0 || b.group < 0 || a.group == border() || b.group == border()) return;
  int& from = connected_from_[static_cast<size_t>(std::max(a.group, b.group))];
  from = std::min({from, a.group, b.group});
}

void WalkLayout::connect_all() {
  connected_from_.resize(sizes_.size());
  std::iota(connected_from_.begin(), connected_from_.end(), 0);
  connected_from_.back() = 0;
  for (Eigen::Index n = 0; n < walks_.measured.size(); ++n) {
    connect(keyframe(walks_.keyframe_i[n]), keyframe(walks_.keyframe_j[n]));
  }
  for (Eigen::Index n = 1; n < user_.size(); ++n) {
    if (is_stepped_to(n)) connect(keyframe(n), keyframe(n - 1));
  }
  for (Eigen::Index n = 0; n < walks_.lasting.size(); ++n) {
    connect(lasting(walks_.lasting[n]), keyframe(walks_.keyframe_i[n]));
    connect(lasting(walks_.lasting[n]), keyframe(walks_.keyframe_j[n]));
  }
  for (Eigen::Index v = 0; v < walks_.follows.size(); ++v) {
    if (walks_.follows[v] >= 0) connect(lasting(v), lasting(walks_.follows[v]));
  }
}

double WalkLayout::height_by_scale(Eigen::Index keyframe, const WalkStates& states) const {
  if (this->keyframe(keyframe).group >= 0) return 0.0;
  return std::exp(states.calibration(user_[keyframe], 0)) * walks_.slam(keyframe, 2);
}

std::pair<Where, double> WalkLayout::height(Eigen::Index keyframe, const WalkStates& states) const {
  Where at = this->keyframe(keyframe);
  if (at.group < 0) return {device(user_[keyframe]), height_by_scale(keyframe, states)};
  at.offset += 2;
  return {at, 1.0};
}

}  // namespace synchronizar
