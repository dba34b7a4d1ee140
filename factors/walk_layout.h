// Where each variable of some walks stands among the rows of the normal equations.
//
// Keyframes are grouped by time, so that steps and ranges connect a group with itself and the one before
// (with one further back after a gap in a track): the matrix of the normal equations is a block envelope with
// a border of what all groups share, which are calibrations and users with one keyframe.
#pragma once

#include <utility>
#include <vector>

#include "factors/walks.h"

namespace synchronizar {

// A group (the border is the last one) and a variable's offset there; -1 if it is fixed.
struct Where {
  int group = -1, offset = 0;
};

class WalkLayout {
 public:
  explicit WalkLayout(Walks walks);

  const Walks& walks() const { return walks_; }
  int user(Eigen::Index keyframe) const { return user_[keyframe]; }

  // Whether a step of SLAM leads to a keyframe, which it does to all of a user but the first.
  bool is_stepped_to(Eigen::Index keyframe) const {
    return keyframe > 0 && user_[keyframe] == user_[keyframe - 1];
  }

  const Where& keyframe(Eigen::Index n) const { return keyframe_[static_cast<size_t>(n)]; }
  const Where& device(Eigen::Index user) const { return device_[static_cast<size_t>(user)]; }
  // The height at which a device is carried; fixed, and of no consequence, where it has one keyframe.
  const Where& own_height(Eigen::Index user) const { return own_height_[static_cast<size_t>(user)]; }
  const Where& lasting(Eigen::Index v) const { return lasting_[static_cast<size_t>(v)]; }
  const Where& shared_calibration() const { return shared_calibration_; }
  const Where& mean_height() const { return mean_height_; }

  // Of each group, how many rows it has, and the first group that it is connected with.
  const std::vector<int>& sizes() const { return sizes_; }
  const std::vector<int>& connected_from() const { return connected_from_; }

  // The derivative of a keyframe's height by its device's log scale where the keyframe is fixed; else 0.
  double height_by_scale(Eigen::Index keyframe, const WalkStates& states) const;

  // The variable by which a keyframe's height moves, and how far.
  std::pair<Where, double> height(Eigen::Index keyframe, const WalkStates& states) const;

 private:
  int border() const { return static_cast<int>(sizes_.size()) - 1; }
  void place_moving(std::vector<int> keyframes);
  void place_border(const std::vector<int>& standing);
  void place_lasting();
  void connect(const Where& a, const Where& b);
  void connect_all();

  Walks walks_;
  Numbers user_;  // (m) of each keyframe
  std::vector<int> sizes_, connected_from_;
  std::vector<Where> keyframe_, device_, own_height_, lasting_;  // (m), (k), (k), (v)
  Where shared_calibration_, mean_height_;
};

}  // namespace synchronizar
