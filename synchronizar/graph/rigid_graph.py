"""The rigid model (Huo et al., UIST 2018) as a gtsam graph: one frame and height per user, SLAM trusted as it is."""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import gtsam
import numpy as np

from synchronizar._core import Bursts, NlosMixture, RangeBlock, UserPose, burst_nlos_odds, search_heights
from synchronizar.arrays import Array
from synchronizar.data.user import User
from synchronizar.graph.range_factors import FixedUser, RangeBlockFactor, UserKeys
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import Pair, RangeMeasurements, pairs

_MEAN_HEIGHT = gtsam.symbol("L", 0)  # double (m): the mean height of all SLAM origins


def keys_of(user: int) -> UserKeys:
    """The keys of a user's frame and height; its SLAM poses are no variables."""
    return UserKeys(gtsam.symbol("F", user), gtsam.symbol("H", user))


def nlos_mixture(parameters: Parameters) -> NlosMixture:
    """The loss of a range under these parameters."""
    return NlosMixture(
        parameters.ranges.detour_scale, parameters.ranges.short_share / (1.0 - parameters.ranges.short_share)
    )


def bursts_of(parameters: Parameters) -> Bursts:
    """The Markov chain of NLOS bursts under these parameters (factors/nlos_bursts.h)."""
    r = parameters.ranges
    return Bursts(r.nlos_share, r.nlos_duration, r.detour_kept, r.detour_fluctuation)


def height_sigma_of(user: User, parameters: Parameters) -> float:
    """m, 1 sigma: how far the user's origin may lie above or below another one of its kind."""
    if user.height_sigma is not None:
        return user.height_sigma
    return parameters.priors.static_height_sigma if user.static else parameters.priors.height_sigma


class PairBlock(NamedTuple):
    """All ranges of a pair, ready for the core."""

    pair: Pair
    t: Array
    sigma: Array
    nlos_odds: Array
    """(n,) prior NLOS odds of each range by itself; the block may have those given its neighbours in time."""
    block: RangeBlock


def blocks_of(measurements: RangeMeasurements) -> list[PairBlock]:
    """One block for each pair of users with ranges."""
    out = []
    for pair in pairs(measurements):
        s = measurements[pair.measurements]
        block = RangeBlock(s.p_i, s.p_j, s.distance, s.sigma, s.nlos_odds)
        out.append(PairBlock(pair, s.t, s.sigma, s.nlos_odds, block))
    return out


def _join(columns: list[Array]) -> Array:
    return np.concatenate([np.zeros(0), *columns])


class RigidGraph:
    """The paper's model for all users at once: SLAM is trusted, the variables are a frame and a height per user.

    The reference's frame is the common one. Heights have a prior about a common mean height. Positions and yaws have a
    prior about the result of the search, so wide that it carries next to no information; it keeps the system solvable
    where ranges alone do not.
    """

    def __init__(
        self,
        blocks: list[PairBlock],
        users: tuple[User, ...],
        active_users: list[int],
        reference: int,
        parameters: Parameters,
    ):
        """`active_users` are the indices of the users in the graph, the reference among them."""
        self.users = users
        self.free = [u for u in active_users if u != reference]
        self.reference = reference
        self.blocks = blocks
        self.parameters = parameters
        self._loss = nlos_mixture(parameters)
        # The mean height is a variable too: the height difference of two alike origins has 1 sigma = height_sigma.
        self._height_sigma = np.array([height_sigma_of(user, parameters) for user in users]) / np.sqrt(2.0)
        self._priors = self._priors_about(np.zeros((len(users), 4)))

    def about(self, frames: Array) -> RigidGraph:
        """The same graph with the wide priors of positions and yaws centred on frames (k, 4)."""
        out = copy(self)
        out._priors = self._priors_about(frames)
        return out

    def _priors_about(self, frames: Array) -> gtsam.NonlinearFactorGraph:
        m = self.parameters
        priors = gtsam.NonlinearFactorGraph()
        wide = gtsam.noiseModel.Diagonal.Sigmas(
            np.array([m.priors.place_sigma, m.priors.place_sigma, m.priors.yaw_sigma])
        )
        for u in self.free:
            x, y, _, yaw = frames[u].tolist()
            priors.addPriorPose2(keys_of(u).frame, gtsam.Pose2(x, y, yaw), wide)
            height_noise = gtsam.noiseModel.Isotropic.Sigma(1, self._height_sigma[u])
            priors.add(gtsam.BetweenFactorDouble(_MEAN_HEIGHT, keys_of(u).height, 0.0, height_noise))
        if self.free:
            height_noise = gtsam.noiseModel.Isotropic.Sigma(1, self._height_sigma[self.reference])
            priors.addPriorDouble(_MEAN_HEIGHT, 0.0, height_noise)
        return priors

    def prior_variances(self, user: int) -> Array:
        """(4,) prior variances of x, y, z (m^2) and yaw (rad^2) relative to the reference."""
        m = self.parameters
        height = self._height_sigma[user] ** 2 + self._height_sigma[self.reference] ** 2
        return np.array([m.priors.place_sigma**2, m.priors.place_sigma**2, height, m.priors.yaw_sigma**2])

    def covariances(self, values: gtsam.Values, factors: gtsam.NonlinearFactorGraph | None = None) -> Array:
        """(k, 4, 4) of additive errors in x, y, z (m, common axes) and yaw (rad), from the joint marginals.

        Zero for the reference, whose frame is the common one; NaN for users that are not active.
        """
        out = np.full((len(self.users), 4, 4), np.nan)
        out[self.reference] = 0.0
        if not self.free:
            return out
        ordering = gtsam.Ordering()
        for u in self.free:
            ordering.push_back(keys_of(u).frame)
            ordering.push_back(keys_of(u).height)
        ordering.push_back(_MEAN_HEIGHT)
        jacobian, _ = (factors or self.factors()).linearize(values).jacobian(ordering)
        # gtsam.Marginals factorises the normal equations, and fails where yaw is nearly unobservable. Normalised
        # columns and a QR, which avoids the normal equations, do not.
        scale = np.linalg.norm(jacobian, axis=0)
        root = np.linalg.inv(np.linalg.qr(jacobian / scale, mode="r")) / scale[:, None]
        # The factors leave out negative curvature in height, for definiteness. A covariance needs it: between two
        # equally good heights the cost is flatter than the factors say. The information in any direction falls to no
        # less than a tenth.
        eigenvalues, vectors = np.linalg.eigh(np.eye(len(root)) + root.T @ self._negative_curvature(values) @ root)
        root = root @ vectors / np.sqrt(np.maximum(eigenvalues, 0.1))
        for k, u in enumerate(self.free):
            rows = root[4 * k : 4 * k + 4]
            # Pose2's tangent is (v in its own axes, yaw), then the height; the result is x, y, z, yaw in common axes.
            yaw = values.atPose2(keys_of(u).frame).theta()
            c, s = np.cos(yaw), np.sin(yaw)
            common_from_body = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]])
            out[u] = common_from_body @ rows @ rows.T @ common_from_body.T
        return out

    def _negative_curvature(self, values: gtsam.Values) -> Array:
        """The negative height curvature of pairs as second derivatives (1/m^2), ordered as in `covariances`."""
        column = {u: 4 * k + 3 for k, u in enumerate(self.free)}
        out = np.zeros((4 * len(self.free) + 1, 4 * len(self.free) + 1))
        for b in self.blocks:
            height_curvature = min(b.block.height_curvature(*self._ends(b, values), self._loss), 0.0)
            row = np.zeros(len(out))
            for user, sign in ((b.pair.i, 1.0), (b.pair.j, -1.0)):
                if user in column:
                    row[column[user]] = sign
            out += height_curvature * np.outer(row, row)
        return out

    def with_bursts(self, values: gtsam.Values) -> tuple[RigidGraph, float]:
        """The same graph with NLOS odds re-estimated at these values, given each range's neighbours in time.

        And the cost of the values: the negative log likelihood of all ranges with NLOS bursts, plus that of the priors.
        """
        blocks, cost = [], 0.0
        for b in self.blocks:
            whitened = b.block.residuals(*self._ends(b, values)) / b.sigma
            odds, chain_cost = burst_nlos_odds(
                b.t,
                whitened,
                b.sigma,
                b.nlos_odds,
                self._loss,
                bursts_of(self.parameters),
            )
            blocks.append(b._replace(block=b.block.with_nlos_odds(odds)))
            cost += chain_cost
        out = copy(self)
        out.blocks = blocks
        return out, cost + float(self._priors.error(values))

    def other_heights(self, frames: Array, excluded: float) -> list[Array]:
        """Joint frames (k, 4) that differ from `frames` in heights alone and are other local optima of the cost.

        Their cost is at most `excluded` above the best one's.
        """
        pairs = [(b.pair.i, b.pair.j, b.block) for b in self.blocks]
        found = search_heights(
            np.nan_to_num(frames),
            self._height_sigma,
            np.isin(np.arange(len(frames)), self.free),
            pairs,
            self._loss,
            excluded,
            self.parameters.search.most_hypotheses,
        )
        return [np.column_stack([frames[:, :2], heights + 0.0 * frames[:, 2], frames[:, 3]]) for heights, _ in found]

    def cost(self, values: gtsam.Values) -> float:
        """Negative log likelihood of the values: the sum of all losses and priors, ranges taken as independent."""
        ranges = sum(b.block.cost(*self._ends(b, values), self._loss) for b in self.blocks)
        return ranges + float(self._priors.error(values))

    def inlier_probability(self, values: gtsam.Values) -> Array:
        """(n,) the probability that each range is line-of-sight, in the order of the ranges."""
        return _join([b.block.inlier_probability(*self._ends(b, values), self._loss) for b in self.blocks])

    def rejected(self, values: gtsam.Values) -> float:
        """The share of ranges that are more likely NLOS or too short than line-of-sight."""
        return float((self.inlier_probability(values) < 0.5).mean())

    def residuals(self, values: gtsam.Values) -> Array:
        """(n,) m, measured minus predicted, in the order of the ranges."""
        return -_join([b.block.residuals(*self._ends(b, values)) for b in self.blocks])

    def weights(self, values: gtsam.Values) -> Array:
        """(n,) the weight that the loss gives each range, without 1 / sigma^2, in the order of the ranges."""
        return _join([b.block.weights(*self._ends(b, values), self._loss) for b in self.blocks])

    def _ends(self, b: PairBlock, values: gtsam.Values) -> tuple[UserPose, UserPose]:
        return self.place(b.pair.i).read(values), self.place(b.pair.j).read(values)

    def place(self, user: int) -> UserKeys | FixedUser:
        """The keys of a user; a fixed user for the reference."""
        return FixedUser(UserPose()) if user == self.reference else keys_of(user)

    def priors(self) -> gtsam.NonlinearFactorGraph:
        """Prior factors of positions, yaws and heights."""
        return gtsam.NonlinearFactorGraph(self._priors)

    def factors(self, annealing: float = 1.0) -> gtsam.NonlinearFactorGraph:
        """Priors, and one range factor for each pair; `annealing` >= 1 widens the loss."""
        graph = self.priors()
        for b in self.blocks:
            graph.add(RangeBlockFactor(self.place(b.pair.i), self.place(b.pair.j), b.block, self._loss, annealing))
        return graph

    def values(self, frames: Array) -> gtsam.Values:
        """The frames (k, 4) x, y, z (m), yaw (rad) of the active users as gtsam values."""
        values = gtsam.Values()
        for u in self.free:
            x, y, z, yaw = frames[u].tolist()
            keys = keys_of(u)
            values.insert(keys.frame, gtsam.Pose2(x, y, yaw))
            values.insert(keys.height, z)
        if self.free:
            values.insert(_MEAN_HEIGHT, self._mean_height(frames))
        return values

    def _mean_height(self, frames: Array) -> float:
        """The most likely mean height (m) at these frames."""
        users = [self.reference, *self.free]
        weight = self._height_sigma[users] ** -2
        return float(weight @ frames[users, 2] / weight.sum())

    def frames(self, values: gtsam.Values) -> Array:
        """Frames (k, 4) x, y, z (m), yaw (rad) at these values; NaN for users that are not active."""
        frames = np.full((len(self.users), 4), np.nan)
        frames[self.reference] = 0.0
        for u in self.free:
            keys = keys_of(u)
            pose = values.atPose2(keys.frame)
            frames[u] = pose.x(), pose.y(), values.atDouble(keys.height), pose.theta()
        return frames
