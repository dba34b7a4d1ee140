"""The C++ core: ranges evaluated by the million (factors/). Lengths m, angles rad; errors are ValueError."""

from synchronizar.arrays import Array, Mask

class UserPose:
    """What places a user's antennas in the common frame: its frame (F, H) and a keyframe pose (X, Z) within it."""

    def __init__(
        self,
        frame_x: float = 0.0,
        frame_y: float = 0.0,
        frame_yaw: float = 0.0,
        frame_height: float = 0.0,
        local_x: float = 0.0,
        local_y: float = 0.0,
        local_yaw: float = 0.0,
        local_height: float = 0.0,
    ) -> None: ...

class _Loss:
    def __call__(self, e: float, sigma: float = 1.0, nlos_odds: float = 0.0) -> tuple[float, float, float]:
        """(rho, weight, curvature) of a whitened residual e = (predicted - measured) / sigma."""

class Squared(_Loss): ...

class Huber(_Loss):
    def __init__(self, k: float = 1.345) -> None: ...
    @property
    def k(self) -> float: ...

class Cauchy(_Loss):
    def __init__(self, k: float = 2.385) -> None: ...
    @property
    def k(self) -> float: ...

class GemanMcClure(_Loss):
    def __init__(self, k: float = 3.0) -> None: ...
    @property
    def k(self) -> float: ...

class NlosMixture(_Loss):
    """Honest, or late by a detour of about `scale` m; too short only by garbage, with odds `early_odds`."""

    def __init__(self, scale: float, early_odds: float) -> None: ...
    @property
    def scale(self) -> float: ...
    @property
    def early_odds(self) -> float: ...

Loss = Squared | Huber | Cauchy | GemanMcClure | NlosMixture

class RangeBlock:
    """n ranges between the antennas of the same two users, evaluated in one call."""

    def __init__(self, o_i: Array, o_j: Array, measured: Array, sigma: Array, nlos_odds: Array) -> None:
        """Antennas (n, 3), each in its user's local frame; distances, sigmas and odds of being late (n,)."""

    def __len__(self) -> int: ...
    def residuals(self, i: UserPose, j: UserPose) -> Array:
        """(n,) predicted minus measured."""

    def cost(self, i: UserPose, j: UserPose, loss: Loss, annealing: float = 1.0) -> float:
        """The sum of the losses."""

    def square_root(self, i: UserPose, j: UserPose, loss: Loss, annealing: float = 1.0) -> Array:
        """(5, 17): rows over i's F (3), H, X (3), Z, then j's, then the residual.

        A quadratic model of the cost: its gradient is exact (factors/range_block.h).
        """

    def height_curvature(self, i: UserPose, j: UserPose, loss: Loss, annealing: float = 1.0) -> float:
        """1/m^2: what the ranges' own bending adds to the cost's second derivative in the difference in height."""

    def weights(self, i: UserPose, j: UserPose, loss: Loss, annealing: float = 1.0) -> Array:
        """(n,) the weight that the loss gives each range, without 1 / sigma^2."""

    def with_nlos_odds(self, nlos_odds: Array) -> RangeBlock:
        """The same ranges with other odds (n,) of being late."""

    def inlier_probability(self, i: UserPose, j: UserPose, loss: NlosMixture) -> Array:
        """(n,) the probability that each range is honest, given its residual."""

class Calibration:
    """What is wrong with a device: log of its scale, its radio's bias (m), its clock (s) beyond what is assumed."""

    def __init__(self, log_scale: float = 0.0, range_bias: float = 0.0, clock_offset: float = 0.0) -> None: ...

Antennas = tuple[Array, Array, Array]
"""(n, 3) each, in the axes of a keyframe: offset from it in SLAM's lengths, lever arm (m), velocity (m/s)."""

class CalibratedRangeBlock:
    """n ranges between the same two keyframes of two devices that are not perfect (factors/device_range.h)."""

    def __init__(
        self, i: Antennas, j: Antennas, measured: Array, sigma: Array, nlos_odds: Array, range_weight: Array
    ) -> None:
        """Distances, sigmas, odds of being late (n,), and as how many ranges each one counts."""

    def __len__(self) -> int: ...
    def residuals(self, pose_i: UserPose, device_i: Calibration, pose_j: UserPose, device_j: Calibration) -> Array:
        """(n,) predicted minus measured."""

    def cost(
        self,
        pose_i: UserPose,
        device_i: Calibration,
        pose_j: UserPose,
        device_j: Calibration,
        loss: Loss,
        annealing: float = 1.0,
    ) -> float:
        """The sum of the losses, each as often as it is worth."""

    def square_root(
        self,
        pose_i: UserPose,
        device_i: Calibration,
        pose_j: UserPose,
        device_j: Calibration,
        loss: Loss,
        annealing: float = 1.0,
        height_curvature: float | None = None,
    ) -> Array:
        """(10, 23): rows over i's F (3), H, X (3), Z, log scale, bias, clock, then j's, then the residual.

        `height_curvature` (1/m^2) stands for that of the block's own ranges in height (factors/device_block.h).
        """

def mixture_terms(whitened: Array, sigma: Array, nlos_odds: Array, loss: NlosMixture) -> tuple[Array, Array, Array]:
    """(n,) each: cost, weight and probability of being honest of ranges with these residuals."""

class Bursts:
    """How NLOS ranges follow each other (factors/nlos_bursts.h)."""

    def __init__(self, share: float, mean_duration: float, keeps_length: float, fluctuation: float) -> None:
        """Long-run share; mean duration (s); probability that a detour is kept; its relative fluctuation (1 sigma)."""

def burst_nlos_odds(
    t: Array, whitened: Array, sigma: Array, nlos_odds: Array, loss: NlosMixture, bursts: Bursts
) -> tuple[Array, float]:
    """(n,) odds of being late that each range's neighbours in time speak for, and the chain's negative log likelihood.

    `t` (n,) s, sorted; `whitened` (n,) residuals over sigma, predicted minus measured.
    """

def search_heights(
    frames: Array,
    sigma: Array,
    free: Mask,
    pairs: list[tuple[int, int, RangeBlock]],
    loss: Loss,
    most_above: float,
    most: int,
) -> list[tuple[Array, float]]:
    """Every combination of heights (k,) m that explains the ranges, and its cost, best first; all else held.

    `frames` (k, 4) x, y, z, yaw of each user; `sigma` (k,) m of its height about the level that all share; `free` (k,)
    whose heights are sought; those of the others that are in a pair are held.
    """

def range_residual(i: UserPose, o_i: Array, j: UserPose, o_j: Array, measured: float) -> tuple[float, Array]:
    """One range: predicted minus measured, and its row (1, 16) over i's F, H, X, Z and j's."""

def search_placements(
    known: Array,
    own: Array,
    measured: Array,
    sigma: Array,
    nlos_odds: Array,
    height_sigma: float,
    has_yaw: bool,
    loss: NlosMixture,
    apart: float,
    most_candidates: int,
    most_ranges: int,
    most_cost_above: float,
) -> Array:
    """(m, 5) x, y, z, yaw, cost of every placement of a user that explains its ranges, best first.

    `known` (n, 3) antennas in the common frame, `own` (n, 3) the user's in its own frame.
    """
