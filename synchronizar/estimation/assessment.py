"""From local optima to states: joint hypotheses, their uncertainty, and a verdict on each user with its reason."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.registration import State
from synchronizar.estimation.hypotheses import Hypothesis, hypotheses
from synchronizar.estimation.integrity import Verdict, nearness, verdicts
from synchronizar.estimation.severed import severed
from synchronizar.estimation.slips import risen_by
from synchronizar.graph.marginals import marginals
from synchronizar.graph.pose_graph import EmWeights, LocalOptimum, PoseGraph, calibration_sigmas
from synchronizar.graph.states import BIAS, CLOCK, SCALE, States
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.extent import extent_points
from synchronizar.preprocessing.range_measurements import RangeMeasurements

_FEWEST_RANGES = 20  # for a share of them


class Assessment(NamedTuple):
    """What the local optima say of each of k users where its track ends, in the graph's frame."""

    optimum: LocalOptimum
    """The best one."""
    verdicts: list[Verdict | None]
    """None for users that no chain of ranges connects to the reference."""
    hypotheses: list[Hypothesis]
    """Joint hypotheses on the last keyframes, best first."""
    covariances: Array
    """(k, 6, 6) of the best hypothesis: errors in x, y, z (m), yaw (rad), log scale, the reference's log scale."""
    joint: Array | None
    """(k, 6, k, 6) of all users together, at the best optimum alone; None where it is not computed."""
    inlier_probability: Array
    """(n,) of each range."""
    weight: Array
    """(n,) 1/m^2: the information that each range brings along its line."""
    extent: Array
    """(k, c, 3) m: extent points of each track about its last keyframe, in SLAM's axes."""
    progress: Array
    """(k,) 0 to 1: how near each user is to being registered; NaN for users that are not active."""
    calibration_sigma: Array | None
    """(k, 3) 1 sigma of log scale, radio bias (m) and clock offset (s), NaN where a radio has none; None: trusted."""


def assess(
    optima: list[LocalOptimum],
    spread: Callable[[LocalOptimum], tuple[Array, float]],
    systematic: Collection[int],
    registered: Collection[int] = (),
    duration: float = np.inf,
    drift: Array | None = None,
) -> Assessment:
    """The assessment of optima, best first, of the same problem.

    `spread` gives an optimum's covariances (k, 4, 4) beside the reference and its log volume. `systematic` are users
    whose residuals are no noise. Users that are `registered` already stay so up to a higher probability of being wrong.
    Judged is where the last `duration` s of each walk would lie. `drift` (k, 2) are the factors on the model's drift
    that were measured.
    """
    best = optima[0]
    graph, states, parameters = best.graph, best.states, best.graph.parameters
    robust, inlier_probability = graph.inlier_probability(states, best.em_weights)
    extent = _extent_about_last(graph, states, duration)
    found = hypotheses(optima, spread, extent, parameters)
    rejected = np.array([_rejected(graph.measurements, inlier_probability, u) for u in range(len(graph.users))])
    progress = np.full(len(graph.users), np.nan)
    for u in graph.free:
        progress[u] = min(1.0, nearness(found[0], u, graph.users[u].static, extent[u], parameters))
    if len(found) > 1 and found[0].agreed is not None:  # as far as the next best hypothesis is excluded
        excluded = min(1.0, max(found[1].cost - found[0].cost, 0.0) / parameters.integrity.cost_excluded_nlos)
        progress[~found[0].agreed] *= excluded
    progress[graph.reference] = 1.0
    covariances = np.zeros((len(graph.users), 6, 6))
    covariances[:, :4, :4] = found[0].covariances
    held = [graph.reference, *np.flatnonzero(graph.problem.surveyed).tolist()]
    cut = severed(graph.measurements, inlier_probability, held, len(graph.users), parameters)
    whole = bool(np.isinf(duration))
    risen = _risen(graph, states) if whole else {}  # while people walk, ranges tell of it as they come
    contradicted = (
        cut | risen | _contradicted(graph, states, best.em_weights, whole, list(cut)) | _no_odometry(graph, drift)
    )
    judged = verdicts(found, rejected, systematic, graph, extent, parameters, registered, contradicted, whole)
    judged = _beside_far_reference(judged, graph, drift)
    for u in np.flatnonzero(graph.problem.surveyed).tolist():
        if (verdict := judged[u]) is not None:
            judged[u] = with_survey(verdict, states.anchor_poses[u, :3] - graph.problem.survey[u], graph, u)
    return Assessment(
        optimum=best,
        verdicts=judged,
        hypotheses=found,
        covariances=covariances,
        joint=None,
        inlier_probability=inlier_probability,
        weight=robust * best.em_weights.range_weight / graph.sigma**2,
        extent=extent,
        progress=progress,
        calibration_sigma=None,
    )


def assess_calibrated(
    optima: list[LocalOptimum], drift: Array, registered: Collection[int] = (), duration: float = np.inf
) -> Assessment:
    """The assessment under the full model; see `assess`."""
    best = optima[0]
    graph, parameters = best.graph, best.graph.parameters
    own = marginals(graph, best.states, best.em_weights)

    def spread(s: LocalOptimum) -> tuple[Array, float]:
        of = own if s is best else marginals(s.graph, s.states, s.em_weights, bent=1)
        return of.relative, of.log_volume

    assessed = assess(optima, spread, (), registered, duration, drift)
    static = np.array([user.static for user in graph.users])
    not_there = static[:, None] & (np.arange(3) != BIAS)
    usual = own.calibrations.copy()
    if graph.calibration_priors.usual_variances is not None:
        usual[graph.active_users] = graph.calibration_priors.usual_variances
    usual[not_there] = np.nan
    height_of = best.states.anchor_poses[:, 2]
    surveyed = graph.problem.surveyed
    level = graph.mean_height(best.states.anchor_poses, best.em_weights.height_weight)
    heights = height_of - (level if surveyed.any() else height_of[graph.reference])
    sigmas = np.where(graph.held_as_usual, graph.height_sigma, graph.other_height_sigma)
    found: list[Verdict | None] = []
    for u, verdict in enumerate(assessed.verdicts):
        if verdict is not None:
            verdict = with_calibration(verdict, usual[u], parameters)
            if not surveyed.any():
                sigma = float(np.hypot(sigmas[u], sigmas[graph.reference]))
                verdict = with_height(verdict, float(heights[u]), sigma, parameters)
            elif u != graph.reference and not surveyed[u]:
                verdict = with_height(verdict, float(heights[u]), float(sigmas[u]), parameters, "the others'")
        found.append(verdict)
    # States are judged beside the reference as it is now, errors told in the frame of its first pose: what the optima
    # differ by adds to both.
    covariances = own.poses.copy()
    covariances[:, :4, :4] += assessed.hypotheses[0].covariances - own.relative
    return assessed._replace(
        verdicts=found,
        covariances=covariances,
        joint=own.joint,
        calibration_sigma=np.sqrt(np.where(not_there, np.nan, own.calibrations)),
    )


def _extent_about_last(graph: PoseGraph, states: States, duration: float) -> Array:
    """(k, c, 3) m: extent points of the last `duration` s of each track about its last keyframe."""
    last = np.array([of_user.place[-1] for of_user in graph.keyframes])
    scale = np.exp(states.calibration[:, SCALE])[:, None, None]
    return np.asarray(scale * (extent_points(graph.problem.recording, duration) - last[:, None]))


def _contradicted(
    graph: PoseGraph, states: States, em_weights: EmWeights, whole: bool, cut: Sequence[int] = ()
) -> dict[int, str]:
    """The users who are not where they seem, and why: their ranges are too short, which nothing makes them.

    Who has most of these goes first, and its ranges count no more for the others. One radio that tells wrong distances
    for a while has many, and the others then none; where nobody has many, but two have some, as where radios were
    exchanged, fewer do in a `whole` recording: while people walk, ranges tell of it as they come. Foreign ranges count
    alike, but for those of one time that is over, and shorter than the rest. Where most may be foreign nobody is known.
    Foreign ranges of those who are `cut` off already count for nobody: they were moved, and their ranges tell of it.
    """
    limits, s = graph.parameters.integrity, graph.measurements
    least = limits.largest_short_of_two if whole else limits.largest_short
    short = graph.residuals(states) > limits.innovation_sigmas * graph.sigma
    foreign = em_weights.own_probability < 0.5
    left = ~(foreign & (np.isin(s.i, cut) | np.isin(s.j, cut)))
    foreign &= left
    if foreign.sum() > limits.largest_foreign_of_all * len(foreign):
        return dict.fromkeys(graph.active_users, f"{foreign.mean():.0%} of all ranges seem to be of other devices")
    shares, k = list[tuple[int, float]](), len(graph.users)
    while len(shares) < k:
        share = np.zeros(k)
        for u in graph.active_users:
            own = np.flatnonzero(left & ((s.i == u) | (s.j == u)))
            if len(own) >= _FEWEST_RANGES:
                own = own[np.argsort(s.t[own], kind="stable")]
                over = _is_over(foreign[own], limits.largest_foreign)
                off = short[own] & ~foreign[own] if over else short[own] | foreign[own]
                share[u] = off.mean()
        u = max(range(k), key=lambda v: (float(share[v]), v != graph.reference))
        if share[u] <= least:
            break
        shares.append((u, float(share[u])))
        left &= (s.i != u) & (s.j != u)
    most = max((share for _, share in shares), default=0.0)
    if most > limits.largest_short:
        shares = [(u, share) for u, share in shares if share > limits.largest_short]
    elif len(shares) < 2:
        return {}
    blamed = [u for u, _ in shares]
    for u in graph.active_users if blamed else ():  # who disagrees with them throughout may be wrong itself
        own = np.flatnonzero((s.i == u) | (s.j == u))
        of = foreign[own[np.argsort(s.t[own], kind="stable")]]
        if u not in blamed and _extent(of) > limits.largest_foreign_of_others and of.mean() > limits.largest_short:
            shares.append((u, float(of.mean())))
    of_others = "" if not foreign.any() else ", or those of other devices"
    reason = "{:.0%} of its ranges are too short by more than noise" + of_others + ": it is not where its track has it"
    return {u: reason.format(share) for u, share in shares}


def _is_over(foreign: Mask, largest: float) -> bool:
    """Whether ranges (n,) in the order of time were foreign once, for a share of `largest` at most, and fit since."""
    return not foreign.any() or (_extent(foreign) < largest and not bool(foreign[-_FEWEST_RANGES:].any()))


def _extent(foreign: Mask) -> float:
    """The share of ranges (n,) in the order of time that lies between the first foreign one and the last."""
    at = np.flatnonzero(foreign)
    return float(at[-1] - at[0]) / len(foreign) if len(at) else 0.0


def _no_odometry(graph: PoseGraph, drift: Array | None) -> dict[int, str]:
    """The users whose ranges fit their tracks only with drift that no odometry has, and how far that is."""
    if drift is None:
        return {}
    slam, limits = graph.parameters.slam, graph.parameters.integrity
    metres = drift[:, 0] * np.hypot(slam.drift_m_per_sqrt_s, slam.drift_m_per_sqrt_m)
    radians = drift[:, 1] * np.hypot(slam.drift_rad_per_sqrt_s, slam.drift_rad_per_sqrt_m)
    reason = "its ranges fit its track only if that drifts by {:.2f} m and {:.2f} rad in a second: it is not its track"
    far = (metres > limits.largest_drift_m) | (radians > limits.largest_drift_rad)
    return {u: reason.format(metres[u], radians[u]) for u in np.flatnonzero(far).tolist() if u in graph.active_users}


def _beside_far_reference(judged: list[Verdict | None], graph: PoseGraph, drift: Array | None) -> list[Verdict | None]:
    """The verdicts; of a reference whose track needs wide drift, and beside which nobody is registered, another one."""
    others = [verdict for u, verdict in enumerate(judged) if u != graph.reference and verdict is not None]
    own = judged[graph.reference]
    if drift is None or own is None or any(verdict.state is State.REGISTERED for verdict in others):
        return judged
    times = float(drift[graph.reference].max())
    if times > graph.parameters.search.drift_wide:
        reason = (
            f"nobody is placed beside it, and its ranges fit its track only if that drifts {times:.0f} times as far"
        )
        own = own._replace(state=State.UNOBSERVABLE, reason=reason + " as SLAM does")
    return [own if u == graph.reference else verdict for u, verdict in enumerate(judged)]


def _risen(graph: PoseGraph, states: States) -> dict[int, str]:
    """Who was moved up or down beside the reference without its SLAM, as in a lift, and why nobody knows which.

    Ranges between two levels are the same whichever is the upper one.
    """
    rise = {u: risen_by(states, graph, u) for u in graph.active_users}
    beside = {u: abs(of_user - rise[graph.reference]) for u, of_user in rise.items()}
    return {
        u: f"it was moved {off:.1f} m up or down without its SLAM: its ranges do not tell which"
        for u, off in beside.items()
        if off > graph.parameters.integrity.largest_error
    }


def _rejected(measurements: RangeMeasurements, inlier_probability: Array, user: int) -> float:
    """The share of a user's ranges that are more likely NLOS, or outliers, than inliers."""
    own = (measurements.i == user) | (measurements.j == user)
    return float((inlier_probability[own] < 0.5).mean()) if own.any() else 0.0


def with_survey(verdict: Verdict, off: Array, graph: PoseGraph, user: int) -> Verdict:
    """The verdict; unobservable where the ranges have a surveyed radio `off` (3,) m from its entry."""
    limits, apart = graph.parameters.integrity, float(np.linalg.norm(off))
    if apart < max(limits.survey_contradicted, limits.height_contradicted * float(graph.survey_sigma[user])):
        return verdict
    where = ", ".join(f"{x:+.1f}" for x in off.tolist())
    reason = f"its ranges say that it is {apart:.1f} m from where it was surveyed to be (by {where} m)"
    return verdict._replace(state=State.UNOBSERVABLE, reason=reason)


def with_height(
    verdict: Verdict, above: float, sigma: float, parameters: Parameters, whose: str = "the reference's"
) -> Verdict:
    """The verdict; unobservable where a registered user's height is too many sigmas off its prior."""
    if verdict.state is not State.REGISTERED or abs(above) < parameters.integrity.height_contradicted * sigma:
        return verdict
    side = "above" if above > 0.0 else "below"
    reason = f"its origin would lie {abs(above):.1f} m {side} {whose}: if that can be, set height_sigma"
    return verdict._replace(state=State.UNOBSERVABLE, reason=reason)


def with_calibration(verdict: Verdict, variances: Array, parameters: Parameters) -> Verdict:
    """The verdict, with what of the calibration has a posterior variance above half the prior's, under usual priors."""
    own, common = calibration_sigmas(parameters)
    prior = own**2 + common**2
    names = {SCALE: "scale", BIAS: "range_bias", CLOCK: "clock_offset"}
    dominated = [name for column, name in names.items() if variances[column] > 0.5 * prior[column]]
    return verdict._replace(prior_dominated=(*verdict.prior_dominated, *dominated))
