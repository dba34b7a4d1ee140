"""Two SLAM frames in a gtsam graph of your own: poses are variables, and ranges tie both frames.

For each user u there is a frame in the common one (f Pose2, h height) and, at each keyframe n, a pose in the user's own
frame (x Pose2, z height). The first user's frame is the common one. `RangeFactor` holds one range, here with a robust
noise model of gtsam's; `RangeBlockFactor` holds all ranges between two keyframes under a robust loss.

`python examples/own_gtsam_graph.py`
"""

import gtsam
import numpy as np

import synchronizar as sz

KEYFRAMES, RANGES = 20, 10  # a keyframe a second, and so many ranges after each
FRAMES = [(gtsam.Pose2(), 0.0), (gtsam.Pose2(3.0, 1.0, 1.2), 0.1)]  # the truth: common_from_user and height (m)
STEP_SIGMAS = np.array([0.02, 0.02, 0.01])  # m, m, rad: noise of SLAM from one keyframe to the next
HEIGHT_STEP_SIGMA = 0.02  # m: the same of its height
RANGE_SIGMA = 0.1  # m
ANTENNA = np.array([0.1, 0.0, 0.05])  # m, lever arm in the axes of the device's pose


def main() -> None:
    """Build the graph, solve it, and compare the second user's walk with the truth."""
    random = np.random.default_rng(5)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for u in range(2):
        add_slam(graph, values, u, random)
    add_frames(graph, values)
    for n in range(KEYFRAMES):
        add_ranges(graph, n, random)

    result = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    frame = result.atPose2(gtsam.symbol("f", 1))
    print(f"{graph.size()} factors, cost {graph.error(values):.0f} -> {graph.error(result):.0f}")
    print(f"found frame {np.round(frame.matrix()[:2, 2], 3)} m, {frame.theta():.3f} rad")
    errors = [
        (frame * result.atPose2(gtsam.symbol("x", 100 + n))).translation() - pose_at(1, n).translation()
        for n in range(KEYFRAMES)
    ]
    print(f"error: {np.linalg.norm(errors, axis=1).max():.3f} m")


def add_slam(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, u: int, random: np.random.Generator) -> None:
    """SLAM's poses of one user as variables, and its noisy steps from one keyframe to the next."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(STEP_SIGMAS)
    height_noise = gtsam.noiseModel.Isotropic.Sigma(1, HEIGHT_STEP_SIGMA)
    frame, height = FRAMES[u]
    pose, local_height = frame.inverse() * pose_at(u, 0), height_at(u, 0) - height
    keys = user_keys(u, 0)
    graph.addPriorPose2(keys.pose, pose, gtsam.noiseModel.Isotropic.Sigma(3, 1e-3))
    graph.addPriorDouble(keys.local_height, local_height, gtsam.noiseModel.Isotropic.Sigma(1, 1e-3))
    values.insert(keys.pose, pose)
    values.insert(keys.local_height, local_height)
    for n in range(KEYFRAMES - 1):
        here, there = user_keys(u, n), user_keys(u, n + 1)
        step = pose_at(u, n).between(pose_at(u, n + 1)).retract(random.normal(0.0, STEP_SIGMAS))
        lift = height_at(u, n + 1) - height_at(u, n) + random.normal(0.0, HEIGHT_STEP_SIGMA)
        graph.add(gtsam.BetweenFactorPose2(here.pose, there.pose, step, noise))
        graph.add(gtsam.BetweenFactorDouble(here.local_height, there.local_height, lift, height_noise))
        pose, local_height = pose * step, local_height + lift
        values.insert(there.pose, pose)
        values.insert(there.local_height, local_height)


def add_frames(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    """Both users' frames: the first one is held, the second begins 1 m and 0.5 rad beside the truth."""
    first, second = user_keys(0, 0), user_keys(1, 0)
    graph.addPriorPose2(first.frame, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3))
    graph.addPriorDouble(first.height, 0.0, gtsam.noiseModel.Isotropic.Sigma(1, 1e-3))
    # Ranges hardly see heights on level ground.
    graph.addPriorDouble(second.height, 0.0, gtsam.noiseModel.Isotropic.Sigma(1, 0.15))
    for keys, frame in ((first, gtsam.Pose2()), (second, FRAMES[1][0] * gtsam.Pose2(0.8, -0.6, 0.5))):
        values.insert(keys.frame, frame)
        values.insert(keys.height, 0.0)


def add_ranges(graph: gtsam.NonlinearFactorGraph, n: int, random: np.random.Generator) -> None:
    """The ranges of the second after keyframe n; one in ten has no line of sight and is 1.5 m too long."""
    i, j = user_keys(0, n), user_keys(1, n)
    times = n + np.arange(RANGES) / RANGES
    antennas = [np.array([antenna_after(u, n, t) for t in times]) for u in range(2)]
    true = [np.array([antenna_at(pose_at(u, t), height_at(u, t)) for t in times]) for u in range(2)]
    distances = np.linalg.norm(true[0] - true[1], axis=1)
    measured = distances + random.normal(0.0, RANGE_SIGMA, RANGES) + 1.5 * (random.random(RANGES) < 0.1)

    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.345)
    robust = gtsam.noiseModel.Robust.Create(huber, gtsam.noiseModel.Isotropic.Sigma(1, RANGE_SIGMA))
    graph.add(sz.RangeFactor(i, j, antennas[0][0], antennas[1][0], measured[0], robust))

    sigmas, odds = np.full(RANGES - 1, RANGE_SIGMA), np.zeros(RANGES - 1)
    block = sz.RangeBlock(antennas[0][1:], antennas[1][1:], measured[1:], sigmas, odds)
    graph.add(sz.RangeBlockFactor(i, j, block, sz.Cauchy()))


def user_keys(u: int, n: int) -> sz.UserKeys:
    """The variables that place user u at keyframe n."""
    return sz.UserKeys(
        frame=gtsam.symbol("f", u),
        height=gtsam.symbol("h", u),
        pose=gtsam.symbol("x", 100 * u + n),
        local_height=gtsam.symbol("z", 100 * u + n),
    )


def pose_at(u: int, t: float) -> gtsam.Pose2:
    """The true pose of user u at t (s) in the common frame."""
    if u == 0:
        return gtsam.Pose2(2.0 * np.sin(0.5 * t), 2.0 * np.sin(0.8 * t), 0.5 * t)
    return gtsam.Pose2(3.0 * np.cos(0.4 * t), 2.0 * np.sin(0.6 * t), -0.3 * t)


def height_at(u: int, t: float) -> float:
    """Its true height (m)."""
    return FRAMES[u][1] + 0.1 * np.sin((0.9, 0.7)[u] * t)


def antenna_at(pose: gtsam.Pose2, height: float) -> np.ndarray:
    """(3,) m: where the antenna is, of a device at this pose and height."""
    return np.append(pose.transformFrom(ANTENNA[:2]), height + ANTENNA[2])


def antenna_after(u: int, n: int, t: float) -> np.ndarray:
    """(3,) m: where SLAM has the antenna at time t in the axes of keyframe n; over a second it hardly drifts."""
    return antenna_at(pose_at(u, n).between(pose_at(u, t)), height_at(u, t) - height_at(u, n))


if __name__ == "__main__":
    main()
