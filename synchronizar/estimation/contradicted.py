"""Who is not where it seems, by what it does not fit, and why, in words for its verdict."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.registration import State
from synchronizar.estimation.integrity import Verdict
from synchronizar.estimation.slips import risen_by
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.states import States
from synchronizar.parameters import IntegrityParameters


def contradicted_users(
    graph: PoseGraph,
    states: States,
    em_weights: EmWeights,
    cut: Mapping[int, str],
    drift: Array | None,
    whole: bool,
    unfit: Collection[int] = (),
) -> dict[int, str]:
    """The users who are not where they seem, with the reason.

    Who is on the other side of a `cut` (`severed`), who was moved up or down, whose ranges are too short or of other
    devices, whose track needs `drift` (k, 2), factors on the model's, that no odometry has. `whole`: all has come.
    Of those who are `unfit` hardly any range fits.
    """
    risen = _risen(graph, states) if whole else {}  # while people walk, ranges tell of it as they come
    by_ranges = contradicted_by_ranges(graph, states, em_weights, whole, list(cut), unfit)
    return dict(cut) | risen | by_ranges | _no_odometry(graph, drift)


def contradicted_by_ranges(
    graph: PoseGraph,
    states: States,
    em_weights: EmWeights,
    whole: bool,
    cut: Sequence[int] = (),
    unfit: Collection[int] = (),
) -> dict[int, str]:
    """The users who are not where they seem, and why: their ranges are too short, which nothing makes them.

    Who has most of these goes first, and its ranges count no more for the others. One radio that tells wrong distances
    for a while has many, and the others then none; where nobody has many, but two have some, as where radios were
    exchanged, fewer do in a `whole` recording: while people walk, ranges tell of it as they come. Foreign ranges count
    alike, but for those of one time that is over, and shorter than the rest. Where most may be foreign nobody is known.
    Foreign ranges of those who are `cut` off already count for nobody: they were moved, and their ranges tell of it.
    Those of who is `unfit` count for itself alone where others agree without it.
    """
    limits, s = graph.parameters.integrity, graph.measurements
    least = limits.largest_short_of_two if whole else limits.largest_short
    short = graph.residuals(states) > limits.innovation_sigmas * graph.sigma
    foreign = em_weights.own_probability < 0.5
    left = ~(foreign & (np.isin(s.i, cut) | np.isin(s.j, cut)))
    foreign &= left
    if foreign.sum() > limits.largest_foreign_of_all * len(foreign):
        return dict.fromkeys(graph.active_users, f"{foreign.mean():.0%} of all ranges seem to be of other devices")
    by_time = np.argsort(s.t, kind="stable")

    def ranges_of(u: int, among: Mask) -> Indices:
        return np.asarray(by_time[(among & ((s.i == u) | (s.j == u)))[by_time]])

    shares, k = list[tuple[int, float]](), len(graph.users)
    while len(shares) < k:
        share = np.zeros(k)
        for u in graph.active_users:
            own = ranges_of(u, left)
            if len(own) >= limits.share_fewest:
                over = _is_over(foreign[own], limits)
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
    blamed, everything = [u for u, _ in shares], np.ones(len(s), dtype=bool)
    fit = ~np.isin(s.i, list(unfit)) & ~np.isin(s.j, list(unfit))
    for u in graph.active_users if blamed else ():  # who disagrees with them throughout may be wrong itself
        agreed = (~foreign & ~short)[ranges_of(u, fit)].sum() >= limits.share_fewest
        of = foreign[ranges_of(u, fit if agreed else everything)]
        if u not in blamed and _extent(of) > limits.largest_foreign_of_others and of.mean() > limits.largest_short:
            shares.append((u, float(of.mean())))
    of_others = "" if not foreign.any() else ", or those of other devices"
    reason = "{:.0%} of its ranges are too short by more than noise" + of_others + ": it is not where its track has it"
    return {u: reason.format(share) for u, share in shares}


def _is_over(foreign: Mask, limits: IntegrityParameters) -> bool:
    """Whether ranges (n,) in the order of time were foreign once, for a share at most, and fit since."""
    latest = foreign[-limits.share_fewest :]
    return not foreign.any() or (_extent(foreign) < limits.largest_foreign and not bool(latest.any()))


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


def beside_far_reference(judged: list[Verdict | None], graph: PoseGraph, drift: Array | None) -> list[Verdict | None]:
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
