"""From local optima to states: joint hypotheses, their uncertainty, and a verdict on each user with its reason."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.estimation.contradicted import beside_far_reference, contradicted_users
from synchronizar.estimation.hypotheses import Hypothesis, hypotheses
from synchronizar.estimation.integrity import Evidence, Verdict, nearness, verdicts
from synchronizar.estimation.severed import severed
from synchronizar.graph.marginals import marginals
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.priors import calibration_sigmas
from synchronizar.graph.states import BIAS, CLOCK, SCALE, States
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.extent import extent_points
from synchronizar.preprocessing.range_measurements import RangeMeasurements


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
    unfit = np.flatnonzero(rejected > parameters.integrity.largest_rejected).tolist()
    contradicted = contradicted_users(graph, states, best.em_weights, cut, drift, whole, unfit)
    evidence = Evidence(rejected, extent, systematic, registered, contradicted, whole)
    judged = verdicts(found, evidence, graph, parameters)
    judged = beside_far_reference(judged, graph, drift)
    for u in np.flatnonzero(graph.problem.surveyed).tolist():
        if (verdict := judged[u]) is not None:
            judged[u] = with_survey(verdict, states.anchor_poses[u, :3] - graph.problem.survey[u], graph, u)
    judged = _with_doubted_entries(judged, found, graph)
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


def _with_doubted_entries(
    judged: list[Verdict | None], found: list[Hypothesis], graph: PoseGraph
) -> list[Verdict | None]:
    """The verdicts; the reason of an ambiguity is the survey where placements differ in which entry of it is wrong."""
    limit, survey = graph.parameters.integrity.survey_contradicted, graph.problem.survey
    off = np.array([np.linalg.norm(one.frames[:, :3] - survey, axis=1) > limit for one in found])
    names = " or ".join(graph.users[u].name for u in np.flatnonzero(off.any(axis=0) & ~off.all(axis=0)).tolist())
    if not names:
        return judged
    reason = f"{len(found)} joint placements explain the ranges: the entry of {names} in the survey may be wrong"
    return [one._replace(reason=reason) if one is not None and one.state is State.AMBIGUOUS else one for one in judged]


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
