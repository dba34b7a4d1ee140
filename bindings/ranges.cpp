// Ranges of one pair and of one slot, with their derivatives by frames and calibrations.
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <optional>
#include <utility>

#include "bindings/bindings.h"
#include "bindings/checks.h"
#include "factors/range.h"
#include "factors/range_block.h"
#include "factors/range_slot.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace synchronizar {

namespace {

template <class Poses>
void check_slot(const RangeSlot& slot, const Poses& poses, const SlotCalibrations& calibrations,
                const std::optional<Column>& height_curvature = std::nullopt) {
  require(poses.rows() == slot.users() && calibrations.rows() == slot.users(),
          "poses and calibrations must have one row a user");
  require(!height_curvature || static_cast<size_t>(height_curvature->size()) == slot.pairs().size(),
          "height_curvature must have one number a pair");
}

}  // namespace

void bind_ranges(nb::module_& m) {
  nb::class_<UserPose>(m, "UserPose")
      .def(nb::init<double, double, double, double, double, double, double, double>(), "frame_x"_a = 0.0,
           "frame_y"_a = 0.0, "frame_yaw"_a = 0.0, "frame_height"_a = 0.0, "local_x"_a = 0.0,
           "local_y"_a = 0.0, "local_yaw"_a = 0.0, "local_height"_a = 0.0);

  m.def(
      "range_residual",
      [](const UserPose& i, const Vector3& o_i, const UserPose& j, const Vector3& o_j, double measured) {
        Eigen::Matrix<double, 1, 2 * kUserColumns> row;
        const double residual = range_residual(i, o_i, j, o_j, measured, &row);
        return std::pair(residual, row);
      },
      "i"_a, "o_i"_a, "j"_a, "o_j"_a, "measured"_a);

  nb::class_<RangeBlock>(m, "RangeBlock")
      .def(
          "__init__",
          [](RangeBlock* self, const Points& o_i, const Points& o_j, const Column& measured,
             const Column& sigma, const Column& nlos_odds) {
            check_ranges(o_i, o_j, measured, sigma, nlos_odds);
            new (self) RangeBlock(o_i, o_j, measured, sigma, nlos_odds);
          },
          "o_i"_a, "o_j"_a, "measured"_a, "sigma"_a, "nlos_odds"_a)
      .def("__len__", &RangeBlock::size)
      .def("residuals", &RangeBlock::residuals, "i"_a, "j"_a)
      .def(
          "cost",
          [](const RangeBlock& self, const UserPose& i, const UserPose& j, const LossKind& loss,
             double annealing) { return self.cost(i, j, make_loss(loss, annealing)); },
          "i"_a, "j"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "square_root",
          [](const RangeBlock& self, const UserPose& i, const UserPose& j, const LossKind& loss,
             double annealing) { return self.square_root(i, j, make_loss(loss, annealing)); },
          "i"_a, "j"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "height_curvature",
          [](const RangeBlock& self, const UserPose& i, const UserPose& j, const LossKind& loss,
             double annealing) { return self.height_curvature(i, j, make_loss(loss, annealing)); },
          "i"_a, "j"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "weights",
          [](const RangeBlock& self, const UserPose& i, const UserPose& j, const LossKind& loss,
             double annealing) { return self.weights(i, j, make_loss(loss, annealing)); },
          "i"_a, "j"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "with_nlos_odds",
          [](const RangeBlock& self, const Column& nlos_odds) {
            check_nlos_odds(nlos_odds, self.size());
            return self.with_nlos_odds(nlos_odds);
          },
          "nlos_odds"_a)
      .def("inlier_probability", &RangeBlock::inlier_probability, "i"_a, "j"_a, "loss"_a);

  nb::class_<RangeSlot>(m, "RangeSlot")
      .def(
          "__init__",
          [](RangeSlot* self, int users, const Numbers& user_i, const Numbers& user_j,
             const std::array<Points, 3>& i, const std::array<Points, 3>& j, const Column& measured,
             const Column& sigma, const Column& nlos_odds, const Column& range_weight) {
            check_ranges(i[0], j[0], measured, sigma, nlos_odds);
            check_range_weight(range_weight, measured.size());
            require(user_i.size() == measured.size() && user_j.size() == measured.size(),
                    "user_i and user_j must be (n,)");
            require((user_i.array() >= 0).all() && (user_j.array() >= 0).all() &&
                        (user_i.array() < users).all() && (user_j.array() < users).all(),
                    "a range names a user that is not there");
            require((user_i.array() != user_j.array()).all(), "a range is between two users");
            const Antennas at_i{i[0], i[1], i[2]}, at_j{j[0], j[1], j[2]};
            check_antennas(at_i, measured.size());
            check_antennas(at_j, measured.size());
            new (self) RangeSlot(users, user_i, user_j, at_i, at_j, measured, sigma, nlos_odds, range_weight);
          },
          "users"_a, "user_i"_a, "user_j"_a, "i"_a, "j"_a, "measured"_a, "sigma"_a, "nlos_odds"_a,
          "range_weight"_a)
      .def("__len__", &RangeSlot::size)
      .def_prop_ro("users", &RangeSlot::users)
      .def_prop_ro("pairs", &RangeSlot::pairs)
      .def(
          "with_weights",
          [](const RangeSlot& self, const Column& nlos_odds, const Column& range_weight) {
            check_nlos_odds(nlos_odds, self.size());
            check_range_weight(range_weight, self.size());
            return self.with_weights(nlos_odds, range_weight);
          },
          "nlos_odds"_a, "range_weight"_a)
      .def(
          "residuals",
          [](const RangeSlot& self, const SlotPoses& poses, const SlotCalibrations& calibrations) {
            check_slot(self, poses, calibrations);
            return self.residuals(poses, calibrations);
          },
          "poses"_a, "calibrations"_a)
      .def(
          "cost",
          [](const RangeSlot& self, const SlotPoses& poses, const SlotCalibrations& calibrations,
             const LossKind& loss, double annealing) {
            check_slot(self, poses, calibrations);
            return self.cost(poses, calibrations, make_loss(loss, annealing));
          },
          "poses"_a, "calibrations"_a, "loss"_a, "annealing"_a = 1.0)
      .def(
          "square_root",
          [](const RangeSlot& self, const SlotPoses& poses, const SlotCalibrations& calibrations,
             const LossKind& loss, double annealing, const std::optional<Column>& height_curvature) {
            check_slot(self, poses, calibrations, height_curvature);
            return self.square_root(poses, calibrations, make_loss(loss, annealing), height_curvature);
          },
          "poses"_a, "calibrations"_a, "loss"_a, "annealing"_a = 1.0, "height_curvature"_a = nb::none())
      .def(
          "square_root_frames",
          [](const RangeSlot& self, const RangeSlot::SlotFrames& frames, const SlotCalibrations& calibrations,
             const LossKind& loss, double annealing, const std::optional<Column>& height_curvature) {
            check_slot(self, frames, calibrations, height_curvature);
            return self.square_root_frames(frames, calibrations, make_loss(loss, annealing),
                                           height_curvature);
          },
          "frames"_a, "calibrations"_a, "loss"_a, "annealing"_a = 1.0, "height_curvature"_a = nb::none());
}

}  // namespace synchronizar
