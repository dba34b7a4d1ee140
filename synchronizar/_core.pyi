"""The C++ core (factors/): range residuals, Jacobians, losses and searches. Lengths m, angles rad.

Bad arguments raise ValueError. Odds are P(NLOS) / P(not NLOS).
"""

from collections.abc import Sequence

from synchronizar.arrays import Array, Indices, Mask

class UserPose:
    """common_from_local of a user: its frame (F, H) and one of its keyframe poses (X, Z) in that frame."""

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
    """Line-of-sight, or NLOS with a half-Cauchy extra length of scale `scale` m; too short with odds `early_odds`."""

    def __init__(self, scale: float, early_odds: float) -> None: ...
    @property
    def scale(self) -> float: ...
    @property
    def early_odds(self) -> float: ...

Loss = Squared | Huber | Cauchy | GemanMcClure | NlosMixture

class RangeBlock:
    """n ranges between the antennas of the same two users, evaluated in one call."""

    def __init__(self, o_i: Array, o_j: Array, measured: Array, sigma: Array, nlos_odds: Array) -> None:
        """Antennas (n, 3) m, each in its user's local frame; distances (m), sigmas (m) and NLOS odds (n,)."""

    def __len__(self) -> int: ...
    def residuals(self, i: UserPose, j: UserPose) -> Array:
        """(n,) m, predicted minus measured."""

    def cost(self, i: UserPose, j: UserPose, loss: Loss, annealing: float = 1.0) -> float:
        """Negative log likelihood: the sum of the losses."""

    def square_root(self, i: UserPose, j: UserPose, loss: Loss, annealing: float = 1.0) -> Array:
        """(5, 17) square-root information [A b]: columns of i's F (3), H, X (3), Z, then j's, then the residual.

        A quadratic model of the cost with the exact gradient A' b (factors/range_block.h).
        """

    def height_curvature(self, i: UserPose, j: UserPose, loss: Loss, annealing: float = 1.0) -> float:
        """1/m^2: second derivative of the cost in the height difference by the curvature of the distances."""

    def weights(self, i: UserPose, j: UserPose, loss: Loss, annealing: float = 1.0) -> Array:
        """(n,) weight rho'(e) / e that the loss gives each range, without 1 / sigma^2."""

    def with_nlos_odds(self, nlos_odds: Array) -> RangeBlock:
        """The same ranges with other NLOS odds (n,)."""

    def inlier_probability(self, i: UserPose, j: UserPose, loss: NlosMixture) -> Array:
        """(n,) the probability that each range is line-of-sight, given its residual."""

Antennas = tuple[Array, Array, Array]
"""(n, 3) each, in the axes of a keyframe: offset from it (SLAM units), lever arm (m), velocity (m/s)."""

class RangeSlot:
    """n ranges between k users, each of whom is at one keyframe (factors/range_slot.h)."""

    def __init__(
        self,
        users: int,
        user_i: Indices,
        user_j: Indices,
        i: Antennas,
        j: Antennas,
        measured: Array,
        sigma: Array,
        nlos_odds: Array,
        range_weight: Array,
    ) -> None:
        """`user_i`, `user_j` (n,) number the k users from 0.

        (n,) each: distances (m), sigmas (m), NLOS odds, and the number of independent ranges that each counts as.
        """

    def __len__(self) -> int: ...
    @property
    def users(self) -> int:
        """The number k of users."""

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The pairs of users that range to each other, in the order in which they come first."""

    def with_weights(self, nlos_odds: Array, range_weight: Array) -> RangeSlot:
        """The same ranges with other NLOS odds and range weights (n,)."""

    def residuals(self, poses: Array, calibrations: Array) -> Array:
        """(n,) m, predicted minus measured.

        `poses` (k, 8) are the arguments of UserPose, `calibrations` (k, 3) those of Calibration.
        """

    def cost(self, poses: Array, calibrations: Array, loss: Loss, annealing: float = 1.0) -> float:
        """Negative log likelihood: the sum of the losses times the range weights."""

    def square_root(
        self,
        poses: Array,
        calibrations: Array,
        loss: Loss,
        annealing: float = 1.0,
        height_curvature: Array | None = None,
    ) -> Array:
        """(r, 11 k + 1) [A b] with r <= 7 k + 1: of each user F (3), H, X (3), Z, log scale, bias, clock; the residual.

        `height_curvature` (1/m^2), one number for each of `pairs`, replaces the pairs' own.
        """

    def square_root_frames(
        self,
        frames: Array,
        calibrations: Array,
        loss: Loss,
        annealing: float = 1.0,
        height_curvature: Array | None = None,
    ) -> Array:
        """(r, 7 k + 1) [A b]: F (3), H, log scale, bias, clock of each user; keyframes lie at the frames' origins.

        `frames` (k, 4) x, y, yaw, height of each user.
        """

class WalkNoise:
    """Weights and priors of the walks of k users with m keyframes and n ranges (factors/walk_solver.h)."""

    def __init__(
        self,
        nlos_odds: Array,
        range_weight: Array,
        step_sigma: Array,
        about: Array,
        place_sigma: Array,
        yaw_sigma: float,
        height_sigma: Array,
        surveyed: Mask,
        device_sigma: Array,
        known_bias_sigma: Array,
        shared_sigma: Array,
        assumed_clock: Array,
        lasting_sigma: Array,
        level_information: Array,
    ) -> None:
        """Of ranges (n,) each; `step_sigma` (m, 3) of the step to each keyframe: in the plane, height and yaw.

        `about` (k, 4) prior means of each user's first keyframe, with `place_sigma` (k,) and `yaw_sigma`;
        `height_sigma` (k,) of origins about their mean, of `surveyed` ones about their own; `device_sigma` (k, 3) of
        calibrations about the shared one, `known_bias_sigma` (k,) of biases about 0 besides, infinite where unknown;
        `shared_sigma` (3,) of the shared one about 0; `assumed_clock` (k,) s at which antennas were read;
        `lasting_sigma` (v,) m, of each lasting error by itself; `level_information` (m,) 1/m^2, of each keyframe's
        height about that at which its device is carried.
        """

class WalkSolver:
    """The most likely walks of k users with m keyframes, given n ranges (factors/walk_solver.h)."""

    def __init__(
        self,
        reference: int,
        first: Indices,
        t: Array,
        slam: Array,
        keyframe_i: Indices,
        keyframe_j: Indices,
        i: Antennas,
        j: Antennas,
        measured: Array,
        sigma: Array,
        lasting: Indices = ...,
        follows: Indices = ...,
        decay: Array = ...,
    ) -> None:
        """`first` (k + 1,) the first keyframe of each user and the end; `t` (m,) s; `slam` (m, 3) SLAM units.

        `keyframe_i`, `keyframe_j` (n,) of each range, antennas in their axes. `lasting` (n,) is which of v lasting
        errors each range has, `follows` (v,) the one before, or -1, and `decay` (v,) the correlation with it, or 0.
        """

    def residuals(self, places: Array, calibration: Array, lasting: Array, assumed_clock: Array) -> Array:
        """(n,) m, predicted minus measured.

        `places` (m, 4) x, y, z, yaw; `calibration` (k, 3); `lasting` (v,) m by which ranges are longer.
        """

    def cost(
        self, places: Array, calibration: Array, lasting: Array, noise: WalkNoise, loss: Loss, annealing: float = 1.0
    ) -> float:
        """Negative log likelihood, at the most likely shared calibration and mean height."""

    def gradient(
        self, places: Array, calibration: Array, lasting: Array, noise: WalkNoise, loss: Loss, annealing: float = 1.0
    ) -> tuple[Array, Array, Array]:
        """(m, 4), (k, 3), (v,): gradient of the cost by places, calibrations, lasting errors; 0 by what is fixed."""

    def optimize(
        self,
        places: Array,
        calibration: Array,
        lasting: Array,
        noise: WalkNoise,
        loss: Loss,
        annealing: float,
        steps: int,
        gain: float,
    ) -> tuple[Array, Array, Array]:
        """Places, calibrations, lasting errors at a local optimum.

        At most `steps` Gauss-Newton steps that gain `gain` or more.
        """

    def covariance(
        self,
        places: Array,
        calibration: Array,
        lasting: Array,
        noise: WalkNoise,
        loss: Loss,
        height_curvature: Array,
        keyframes: Indices,
    ) -> Array:
        """Joint covariance of `keyframes`' x, y, z, yaw, then of all calibrations.

        `height_curvature` (n,) 1/m^2 replaces the ranges' own.
        """

    def step_noise(
        self,
        places: Array,
        calibration: Array,
        lasting: Array,
        noise: WalkNoise,
        loss: Loss,
        kept: Mask,
        counted: Mask,
        tried: Array,
        begin: float,
        weight: float,
        rounds: int,
    ) -> tuple[list[Array], Array, Array]:
        """What ranges say of the noise of the steps to the keyframes `counted` (m,), about each of `tried` (b,).

        Users' own factors are sought from `begin` times that on.

        That is b times (k, 2) factors on step sigmas in place and heading, (b,) the logarithm of the evidence, and (b,)
        how many errors of steps are determined, NaN where the evidence is hopelessly less. Only the keyframes `kept`
        (m,), a run of each user, and the ranges between them are used.
        """

    def log_determinant(
        self,
        places: Array,
        calibration: Array,
        lasting: Array,
        noise: WalkNoise,
        loss: Loss,
        height_curvature: Array,
    ) -> float:
        """The logarithm of the determinant of the cost's second derivatives; `height_curvature` as in `covariance`."""

class RigidSolver:
    """The most likely frames of k users, n ranges between their rigid walks given (factors/rigid_solver.h)."""

    def __init__(
        self,
        active: Mask,
        reference: int,
        first: Indices,
        user_i: Indices,
        user_j: Indices,
        t: Array,
        i: Array,
        j: Array,
        measured: Array,
        sigma: Array,
        nlos_odds: Array,
        height_sigma: Array,
        place_sigma: float,
        yaw_sigma: float,
        survey: Array,
        survey_sigma: Array,
        survey_dof: float,
        loss: NlosMixture,
    ) -> None:
        """`active` (k,) who has a frame; `first` (p + 1,) the first range of each pair of users, and the end.

        `user_i`, `user_j` (p,); `t` (n,) s, sorted within a pair; `i`, `j` (n, 3) m antennas in their users' frames.
        Sigmas of priors: heights' (k,) about their mean, of place and yaw about where an optimisation begins;
        `survey` (k, 3) m where surveyed radios are, NaN of others, with `survey_sigma` (k,) m and Student's t of
        `survey_dof` degrees of freedom.
        """

    def residuals(self, frames: Array) -> Array:
        """(n,) m, predicted minus measured; `frames` (k, 4) x, y, z, yaw."""

    def cost(self, frames: Array, nlos_odds: Array, most: float = ...) -> float:
        """The sum of the losses and the heights' prior; a part of it that is above `most` where it is."""

    def e_step(self, frames: Array, bursts: Bursts) -> tuple[Array, float]:
        """(n,) odds of each range given its neighbours in time, and the cost of the chains and the heights."""

    def optimize(
        self,
        frames: Array,
        about: Array,
        nlos_odds: Array,
        annealing: float,
        steps: int,
        gain: float,
        known: Sequence[Array] = ...,
        same: float = 0.0,
    ) -> Array:
        """Frames at a local optimum: at most `steps` Gauss-Newton steps that gain `gain` or more.

        Ends on the way where frames are within `same` (m and rad) of `known` ones.
        """

    def run_em(
        self,
        frames: Array,
        nlos_odds: Array,
        bursts: Bursts,
        annealing: float,
        rounds: int,
        steps: int,
        gain: float,
        known: Sequence[Array],
        same: float,
        hopeless: float,
    ) -> tuple[Array, Array, float]:
        """Frames, odds and cost after at most so many rounds of optimisation, odds estimated in between.

        Ends where a round gains less than `gain`, where frames are within `same` (m and rad) of `known` ones, or where
        they cost more than `hopeless` after a round.
        """

    def other_heights(self, frames: Array, nlos_odds: Array, most_above: float, most: int) -> list[tuple[Array, float]]:
        """Heights (k,) m that explain the ranges as well, and their costs, as search_heights; frames (k, 4)."""

    def covariances(self, frames: Array, nlos_odds: Array) -> Array:
        """(4 k, 4) of each user's x, y, z, yaw at a local optimum, 0 of what is fixed."""

def residual_inflations(
    first: Indices,
    user_i: Indices,
    user_j: Indices,
    t: Array,
    i: Array,
    j: Array,
    frames: Array,
    residual: Array,
    weight: Array,
    pieces: int,
) -> Array:
    """(k,) factors of covariances by residuals that are no noise (factors/residual_statistics.h)."""

def semidefinite_root(normal: Array) -> Array:
    """Rows R with R' R = `normal`, as many as its rank; `normal` is positive semidefinite but for rounding."""

class Adjustment:
    """Rigid walks of k users moved until n ranges between them fit (factors/adjustment.h)."""

    def __init__(
        self,
        user_i: Indices,
        user_j: Indices,
        p_i: Array,
        p_j: Array,
        measured: Array,
        centre: Array,
        sigma: float,
        soft: float,
    ) -> None:
        """Antennas (n, 3) m in the common frame, distances (n,) m; users turn about `centre` (k, 3) m.

        `sigma` (m) of a range, and `soft` (m), from which on residuals count less.
        """

    def residuals(self, at: Array) -> Array:
        """(n,) m, measured minus predicted, at corrections (k, 6): x, y, z, yaw, bias, scale."""

    def adjust(
        self,
        at: Array,
        free: Indices,
        prior_mean: Array,
        prior_weight: Array,
        steps: int,
        longest: float,
        shortest: float,
    ) -> tuple[Array, Array]:
        """Corrections (k, 6) at the minimum near `at`, and the normal matrix (d, d) of the d variables `free`."""

def neighbour_counts(bounds: Indices, t: Array, reach: float) -> Array:
    """(n,) number of ranges of the same pair within `reach` s of each, itself included.

    Here and below `bounds` are the first range of each of p pairs, and the end; `t` (n,) s is sorted within a pair.
    """

def neighbour_sums(
    bounds: Indices, t: Array, link: Indices, score: Array, weight: Array, gap: float, most: int
) -> tuple[Array, Array, float, float]:
    """Sums over ranges: score^2 and weight^2 of each pair (p,), and over neighbours of score and of weight products.

    Neighbours are ranges of a pair and a link less than `gap` s apart, fewer than `most` ranges of the link apart;
    their score products are divided by their pair's own variance.
    """

def followed_apart(
    ranges: Array, columns: tuple[int, int, int, int, int, int], states: Array, users: int, first: int
) -> tuple[Array, Array, Array]:
    """Of ranges (n, c) of many slots: (n, 3) m from j's antenna to i's, (n,) m that radios add, (n,) m residuals.

    `states` (slots * users, 7) are x, y, yaw, height, log scale, radio bias and clock offset, slot by slot, from slot
    `first` on. `columns` are those of both users, of the slot, of the distance, and the first of nine of each end:
    offset, lever and velocity (3,) each. Residuals are predicted minus measured.
    """

def followed_slot(
    ranges: Array, columns: tuple[int, int, int, int, int, int], weighed: tuple[int, int, int, int, int]
) -> tuple[list[int], RangeSlot]:
    """The users of ranges (n, c) of one slot, sorted, and the ranges pair by pair.

    `columns` as of `followed_apart`; `weighed`: those of stamps, sigma (m), prior odds of NLOS, odds given the other
    ranges, and range weights.
    """

def judged_bursts(
    ranges: Array,
    columns: tuple[int, int, int, int, int, int],
    weighed: tuple[int, int, int, int, int],
    states: Array,
    users: int,
    first: int,
    since: int,
    sizes: Array,
    loss: NlosMixture,
    bursts: Bursts,
    surest: float,
    changed: float,
) -> tuple[list[int], Indices, Array]:
    """Slots from `since` on in which some range is judged otherwise, rows of all their ranges, and their NLOS odds.

    `ranges`, `columns`, `weighed` as of `followed_slot`, the rest as of `followed_apart`. `sizes` (users, users) are
    those of a pair's line-of-sight errors, of what sigma says; `surest` log odds, at most; a range is judged otherwise
    whose probability of line of sight is another one by more than `changed`.
    """

def rows_by_serial(serial: Indices, tables: list[tuple[Indices, Array]], unknown: Array) -> tuple[Mask, Array]:
    """Of ranges by running index (n,) whether any table knows them, and (n, c) what the last one says that does.

    `tables`: running indices (m,) and numbers (m, c); `unknown` (c,): what stands where none knows.
    """

def poses_at(table: Array, columns: tuple[int, int, int], t: Array, longest: float) -> tuple[Array, Array, Mask]:
    """(n, 3) positions, (n, 4) attitudes at times t (n,) and whether they are known, as `data.track.interpolated`.

    `table` (m, c) has a pose a row; `columns` are those of stamps, and the first ones of positions and attitudes.
    """

def read_ranges(
    tables: list[Array | None],
    columns: tuple[int, int, int],
    clocks: Array,
    t: Array,
    users: Indices,
    levers: Array,
    wanted: Mask,
    reach: float,
    longest: float,
) -> tuple[Array, Mask]:
    """(n, 18) ends of ranges at times t (n,) s, and whether poses of both are known there.

    Of i and j of `users` (n, 2) in turn: position, lever (m) and velocity (m/s) of its antenna. `tables` of poses, and
    their `columns`, as of `poses_at`; None for who stands at its origin. `clocks` (k,) s: a device's stamps minus the
    ranges'. `levers` (2 n, 3) m are in body axes. Velocities are means from `reach` s before to as long after, or to
    the last pose.
    """

def mixture_terms(whitened: Array, sigma: Array, nlos_odds: Array, loss: NlosMixture) -> tuple[Array, Array, Array]:
    """(n,) each: loss, weight and probability of line of sight of ranges with these whitened residuals."""

class Bursts:
    """Markov chain of NLOS ranges in time (factors/nlos_bursts.h)."""

    def __init__(self, share: float, mean_duration: float, keeps_length: float, fluctuation: float) -> None:
        """NLOS share in the long run; mean duration (s); probability that a detour is kept; its relative 1 sigma."""

    def with_foreign(self, share: float, mean_duration: float, speed: float, scale: float, least: float) -> Bursts:
        """The same with foreign ranges.

        Their share in the long run; mean duration (s); 1 sigma of how fast such a distance changes (m/s); scale of the
        half Cauchy of distances (m); 1 sigma of errors that are none of it (m).
        """

def burst_nlos_odds(
    t: Array, whitened: Array, sigma: Array, nlos_odds: Array, loss: NlosMixture, bursts: Bursts
) -> tuple[Array, float]:
    """(n,) NLOS odds of each range given its neighbours in time, and the chain's negative log likelihood.

    `t` (n,) s, sorted; `whitened` (n,) (predicted - measured) / sigma; `nlos_odds` (n,) prior odds of each by itself.
    """

def burst_nlos_odds_of_pairs(
    bounds: Indices, t: Array, whitened: Array, sigma: Array, nlos_odds: Array, loss: NlosMixture, bursts: Bursts
) -> tuple[Array, Array]:
    """`burst_nlos_odds` of many pairs, each a chain of its own: odds (n,), and the chains' costs (p,)."""

def foreign_or_nlos_of_pairs(
    bounds: Indices,
    t: Array,
    measured: Array,
    whitened: Array,
    sigma: Array,
    nlos_odds: Array,
    worth: Array,
    loss: NlosMixture,
    bursts: Bursts,
) -> tuple[Array, Array, Array]:
    """The same where ranges may be foreign: odds (n,), probabilities (n,) that each is foreign, costs (p,).

    `measured` (n,) m are the distances, `worth` (p,) is what the costs are multiplied with afterwards. The odds are
    of a range that is not foreign.
    """

def common_shift(
    bounds: Indices,
    t: Array,
    away: Array,
    distance: Array,
    sigma: Array,
    nlos_odds: Array,
    share: Array,
    weight: Array,
    precision: Array,
    starts: Array,
    loss: NlosMixture,
    bursts: Bursts,
) -> tuple[Array, float]:
    """One shift (3,) m of some users' ends that explains their ranges best, and the log likelihood that it gains.

    `bounds` (p + 1,) the first range of each pair and the end; of each range (n,): `t` s, sorted within a pair, `away`
    (n, 3) m from the other end to that of these users, `distance` m as measured, `sigma` m, `nlos_odds`, and `share` of
    the shift that is there at that time; `weight` (p,) of each pair's likelihood; `precision` (3,) 1/m^2 of the shift's
    prior; `starts` (m, 3) m from where it is looked for.
    """

def shifted_groups(
    rows: Array,
    stretches: list[tuple[float, float, bool]],
    fewest: float,
    sigma: float,
    looked_at: float,
    loss: NlosMixture,
    bursts: Bursts,
) -> list[tuple[list[int], Array, float]]:
    """Groups of users whose ranges one shift of theirs explains better, of each stretch of time the best first.

    `rows` (n, 11) are innovations. Of each group its users, its shift (3,) m at the end, and the log likelihood that
    this gains. `stretches`: since when and until when (s), and whether the shift grows evenly from none at the begin,
    or else is there all along. `fewest` ranges are needed, in all and of a group; `sigma` (m) is that of a shift's
    prior; `looked_at`: log likelihood by a linear score from which on a shift is fitted.
    """

def worst_misfit(
    rows: Array,
    stretches: list[tuple[float, bool]],
    sigmas: float,
    fewest: float,
    many: float,
    short_share: float,
    off_share: float,
) -> tuple[int, int, float] | None:
    """The first stretch in which a user's innovations (n, 11) do not fit, the user that fits worst, and the share.

    None where all may be chance: of a user's ranges a share may be too short by `sigmas`, and three standard deviations
    of a binomial count more. `stretches`: since when (s), and whether it is a lasting one: there, where a user has
    `many`, no more than `off_share` may be off to either side. `fewest` ranges are needed, in all and of a user.
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
    """Local optima in the heights (k,) m of all users, and their costs, best first; positions and yaws are fixed.

    `frames` (k, 4) x, y, z, yaw of each user; `sigma` (k,) m of its height about the common mean height; `free` (k,)
    whose heights are variables. At most `most` optima, whose costs are at most `most_above` above the best one's.
    """

def range_residual(i: UserPose, o_i: Array, j: UserPose, o_j: Array, measured: float) -> tuple[float, Array]:
    """One range: predicted minus measured (m), and its Jacobian (1, 16) by i's F, H, X, Z, then j's."""

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
    """(m, 5) x, y, z (m), yaw (rad), cost of every common_from_user that explains a user's ranges, best first.

    `known` (n, 3) m antennas in the common frame, `own` (n, 3) m the user's in its own frame. Frames that move no
    antenna by more than `apart` (m) are the same; their costs are at most `most_cost_above` above the best one's.
    """
