"""Local optima of a pose graph: from the candidates of the search, from their mirror images and from SLAM slips."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.estimation.initialisation import Candidate, extend, placements_in_parts, without_an_entry
from synchronizar.estimation.mirror_images import height_mirrors, reflections
from synchronizar.estimation.slips import relaid
from synchronizar.geometry import difference
from synchronizar.graph.pose_graph import EmWeights, LocalOptimum, PoseGraph, calibration_sigmas
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.graph.states import BIAS, SCALE, States, interpolated
from synchronizar.progress import Progress, unheard

_ANNEALING = (4.0, 2.0)
_FIRST_ROUNDS = 2
_ROUNDS = 8
_MEASURING_ROUNDS = (4, 2)
_REFINING_ROUNDS = 4
_MOST_IMAGES = 6  # mirror images of one optimum that are optimised
_MOST_COMPARED = 6
_MOST_PLACES = 3  # of one user beside all the others that are optimised
_ELSEWHERE = 0.3  # m and rad: by so much they differ from where it is
_DRAWN_SIGMAS = (2.0, 4.0)  # of heights: from priors so many times as wide
_DRAWN_STEPS, _DRAWN_GAIN = 8, 0.1
_PINNED_STEPS = 3
_SAME_HEIGHT = 0.1  # m
_UNUSUAL = 2.0  # sigmas of usual heights
_NOISIER = 2.0  # in range weights: less is no difference
_TRUSTED_STEPS = 2
_SEED = 20  # a fixed draw: the same ranges give the same answer
BETTER = 1.0  # log likelihood: a smaller difference does not rank two optima


def by_cost(optimum: LocalOptimum) -> float:
    """Sort key, best first."""
    return optimum.cost


def find_optima(graph: PoseGraph, starts: list[States], progress: Progress = unheard) -> list[LocalOptimum]:
    """The local optima reached from `starts`, and from slips and mirror images of the best one, best first.

    A rigid graph is not annealed unless ranges are NLOS, and is then started from parts of the walk as well.
    """
    found: list[LocalOptimum] = []
    rigid, search = isinstance(graph, RigidGraph), graph.parameters.search
    for n, states in enumerate(starts, start=1):
        _add_optimum(graph, states, found, () if rigid else _ANNEALING)
        progress(0.5 * n / len(starts))
    if rigid and graph.free and nlos_share(min(found, key=by_cost)) > search.doubtful_share:
        for states in starts:
            _add_optimum(graph, states, found, (search.annealing,))
        for start in placements_in_parts(graph.rigid_problem(starts[0])):
            _add_optimum(graph, graph.initial_states(start.frames), found, ())
    nearest = min(found, key=by_cost)
    if graph.problem.surveyed.any() and (
        nlos_share(nearest) > search.doubtful_share or not np.array_equal(_held(nearest), graph.problem.surveyed)
    ):
        for candidate in without_an_entry(graph.rigid_problem(starts[0]).widened(0.0 if rigid else search.sigma)):
            _add_optimum(graph, graph.initial_states(candidate.frames), found, () if rigid else _ANNEALING)
    best = min(found, key=by_cost)
    while graph.free and len(graph.measurements):
        for states in chain(relaid(best.graph, best.states), _mirror_images(best, found)):
            if isinstance(best.graph, RigidGraph):  # most lead to an optimum that is known
                image = best.graph.image(states, best.em_weights, [optimum.frames for optimum in found])
                if image is None:
                    continue
                states = image
            _add_optimum(best.graph, states, found, ())
        better = min(found, key=by_cost)
        progress(0.8)
        if better.cost > best.cost - BETTER:
            break
        best = better  # which may have mirror images of its own
    return sorted(found, key=by_cost)


def approach(graph: PoseGraph, states: States, annealing: float) -> LocalOptimum:
    """States near a local optimum after a few EM rounds, the first ones annealed."""
    em_weights = _with_search_weights(graph.initial_em_weights())
    near = graph.run_em(states, em_weights, _FIRST_ROUNDS, annealing)
    return near.graph.run_em(near.states, near.em_weights, _FIRST_ROUNDS)


def _add_optimum(graph: PoseGraph, states: States, found: list[LocalOptimum], annealing: tuple[float, ...]) -> None:
    """Optimise from `states` and add the optimum to `found`, unless it is hopeless or within `SAME` of a known one."""
    known = [optimum.frames for optimum in found]
    hopeless = min(found, key=by_cost).cost + graph.parameters.search.hopeless_cost if found else np.inf
    em_weights = _with_search_weights(graph.initial_em_weights())
    for factor in annealing:
        graph, states, em_weights, _ = graph.run_em(states, em_weights, 3, factor)
    if isinstance(graph, RigidGraph):  # many parts of a walk lead to few optima
        rounds = graph.parameters.search.most_rounds
        optimum = graph.run_em(states, em_weights, rounds, known=known, hopeless=hopeless)
    else:
        optimum = graph.run_em(states, em_weights, _FIRST_ROUNDS)
        if optimum.cost > hopeless or graph.is_known(optimum.states, known):
            return
        optimum = optimum.graph.run_em(optimum.states, optimum.em_weights, _ROUNDS, known=known)
    if not graph.is_known(optimum.states, known):
        found.append(optimum)


def nlos_share(optimum: LocalOptimum) -> float:
    """The share of ranges that are more likely NLOS, or outliers, than inliers."""
    _, inlier_probability = optimum.graph.inlier_probability(optimum.states, optimum.em_weights)
    return float((inlier_probability < 0.5).mean()) if len(inlier_probability) else 0.0


def _held(optimum: LocalOptimum) -> Mask:
    """(k,) surveyed radios whose entries the ranges do not contradict, neither by places nor by biases instead."""
    graph = optimum.graph
    off = np.linalg.norm(optimum.states.anchor_poses[:, :3] - graph.problem.survey, axis=1)
    limits = graph.parameters.integrity
    least = np.maximum(limits.survey_contradicted, limits.height_contradicted * graph.survey_sigma)
    own, common = calibration_sigmas(graph.parameters)
    bias = np.abs(optimum.states.calibration[:, BIAS]) / np.hypot(own, common)[BIAS]
    return np.asarray(graph.problem.surveyed & (off < least) & (bias < limits.height_contradicted))


def _with_search_weights(em_weights: EmWeights) -> EmWeights:
    """EM weights with the square root of the range weights: between those of independent and of correlated ranges.

    Which of both holds is measured later. With the weights of correlated ranges, half a walk of ranges taken for NLOS
    would cost less than one SLAM slip.
    """
    return replace(em_weights, range_weight=np.sqrt(em_weights.range_weight))


def _mirror_images(optimum: LocalOptimum, found: list[LocalOptimum]) -> Iterator[States]:
    """States at which mirror images of an optimum may explain the ranges as well, likeliest first.

    Users on one level leave the signs of heights open, users on a line the side of it. Heights that one of the optima
    `found` has are not tried again.
    """
    graph, states = optimum.graph, optimum.states
    rigid, nlos_odds = _rigid(optimum)
    parameters = graph.parameters
    flat = graph.to_rigid_ranges(states)
    range_weight = float(optimum.em_weights.range_weight.mean())
    here = rigid.cost(states.anchor_poses, nlos_odds)
    sigma = np.sqrt(rigid.covariances(states.anchor_poses, nlos_odds)[:, 2, 2] / range_weight)

    def above(frames: Array, most: float) -> float:
        return range_weight * (rigid.cost(frames, nlos_odds, here + most / range_weight) - here)

    heights = rigid.other_heights(
        states.anchor_poses, nlos_odds, parameters.integrity.cost_excluded_nlos / range_weight
    )
    heights += height_mirrors(flat, states.anchor_poses, graph.reference, _held(optimum))
    near, free = parameters.search.mirror_sigmas * sigma[graph.free], graph.free
    known = np.array([s.states.anchor_poses[free, 2] for s in (optimum, *found)])
    apart = [f for f in heights if (np.abs(f[free, 2] - known) > near).any(axis=1).all()]
    most = parameters.search.hopeless_cost
    images = [(cost, frames) for frames in apart if (cost := above(frames, most)) < most]
    most += parameters.search.mirror_cost_per_range * range_weight * len(flat)
    images += [
        (cost, frames)
        for frames in reflections(flat, states.anchor_poses, graph.reference, graph.problem.linked(flat))
        if (cost := above(frames, most)) < most
    ]
    likely = [frames for _, frames in sorted(images, key=lambda image: image[0])[:_MOST_IMAGES]]
    for n, frames in enumerate(likely):
        if not any(np.array_equal(frames, before, equal_nan=True) for before in likely[:n]):
            yield states._replace(anchor_poses=frames)


def is_at_other_heights(optimum: LocalOptimum, other: LocalOptimum) -> bool:
    """Whether mirror images of another optimum have not the heights of this one."""
    off = (optimum.states.anchor_poses - other.states.anchor_poses)[optimum.graph.free, 2]
    return bool((np.abs(off) > _SAME_HEIGHT).any())


def images(optimum: LocalOptimum) -> list[LocalOptimum]:
    """Mirror images of an optimum with measured weights, which explain the ranges by the same heights as it does."""
    out: list[LocalOptimum] = []
    most = optimum.cost + optimum.graph.parameters.search.hopeless_cost
    for states in _mirror_images(optimum, [optimum]):
        known = [other.frames for other in (optimum, *out)]
        image = optimum.graph.run_em(states, optimum.em_weights, _FIRST_ROUNDS)
        if image.cost < most and not image.graph.is_known(image.states, known):
            out.append(image)
    return out


def _rigid(optimum: LocalOptimum) -> tuple[RigidGraph, Array]:
    """The graph in which the frames alone are free at these walks, and the NLOS odds (n,) of its ranges."""
    graph = optimum.graph
    if isinstance(graph, RigidGraph):
        return graph, optimum.em_weights.nlos_odds
    rigid = RigidGraph(graph.rigid_problem(optimum.states), np.zeros((len(graph.users), 3)))
    return rigid, rigid.measurements.nlos_odds


def with_measured_weights(coarse: LocalOptimum) -> LocalOptimum:
    """The same optimum with ranges' weights, and how large their errors in line of sight are, measured on residuals.

    With the model's reflections most short detours pass for line-of-sight; where there are reflections, these may pass
    for NLOS without them. So where ranges seem NLOS without, both are tried, and what is likelier is taken.
    """
    clear = _measured(coarse._replace(graph=coarse.graph.with_reflections(there=False)))
    if nlos_share(clear) <= coarse.graph.parameters.search.doubtful_share:
        return clear
    reflected = _measured(coarse._replace(graph=coarse.graph.with_reflections(there=True)))
    weight = clear.em_weights.range_weight
    return min(clear, reflected, key=lambda optimum: _normalised_cost(optimum, weight))


def _measured(optimum: LocalOptimum) -> LocalOptimum:
    for rounds in _MEASURING_ROUNDS:
        optimum = _measured_again(optimum, rounds)
    return optimum


def _normalised_cost(optimum: LocalOptimum, range_weight: Array) -> float:
    """Negative log likelihood with these range weights (n,), up to a constant whatever the ranges' sigmas are."""
    graph = optimum.graph
    _, cost = graph.e_step(optimum.states, replace(optimum.em_weights, range_weight=range_weight))
    return cost + float(range_weight @ np.log(graph.sigma))


def with_noise_alone(optimum: LocalOptimum) -> LocalOptimum:
    """The optimum of measured weights, or another one that leaves less of the ranges unexplained.

    What is systematic passes for noise once weights are measured on it: with weights that small a prior holds a wrong
    height against all ranges. So ranges are taken for as good as they are said to be, and measured again where that
    leads. The other optimum is believed where it gains more by its weights than it loses by those of the first.
    """
    graph, states, em_weights, _ = optimum
    if not len(graph.measurements):
        return optimum
    said = (graph.sigma / graph.measurements.sigma) ** 2
    if _NOISIER * float(em_weights.range_weight.mean()) > float(said.mean()):
        return optimum
    other = with_measured_weights(graph.run_em(states, replace(em_weights, range_weight=said), _FIRST_ROUNDS))
    if float(other.em_weights.range_weight.mean()) < _NOISIER * float(em_weights.range_weight.mean()):
        return optimum
    return _more_credible(optimum, other)


def with_devices_trusted(optimum: LocalOptimum) -> LocalOptimum:
    """The optimum of measured weights, or the one that is near where devices and ranges are as they say.

    Among NLOS ranges a walk may have bent until late ones pass for others. So SLAM is taken as it is, devices for
    faultless and ranges for as good as they are said to be; then all is free again from there.
    """
    graph, states = optimum.graph, optimum.states
    if nlos_share(optimum) <= graph.parameters.search.doubtful_share:
        return optimum
    clear = graph.with_reflections(there=False)
    rigid = RigidGraph(clear.rigid_problem(clear.initial_states(states.anchor_poses)), np.zeros((len(graph.users), 3)))
    annealing = graph.parameters.search.annealing
    near = rigid.run_em(rigid.initial_states(states.anchor_poses), rigid.initial_em_weights(), _FIRST_ROUNDS, annealing)
    near = rigid.run_em(near.states, near.em_weights, _ROUNDS)
    first = replace(
        graph.initial_em_weights(),
        nlos_odds=near.em_weights.nlos_odds,
        range_weight=np.ones(len(graph.measurements)),
    )
    begin = clear.initial_states(near.states.anchor_poses)
    begin = clear.optimised(begin, begin.anchor_poses, first, 1.0, _TRUSTED_STEPS, _DRAWN_GAIN)
    return _more_credible(optimum, with_measured_weights(clear.run_em(begin, first, _FIRST_ROUNDS)))


def _more_credible(optimum: LocalOptimum, other: LocalOptimum) -> LocalOptimum:
    """Of two optima with measured weights the other one if it gains more by its own than it loses by the first's."""
    ours, others = optimum.em_weights.range_weight, other.em_weights.range_weight
    gain = _normalised_cost(optimum, others) - _normalised_cost(other, others)
    loss = _normalised_cost(other, ours) - _normalised_cost(optimum, ours)
    return other if gain > loss + BETTER else optimum


def refine(coarse: LocalOptimum, graph: PoseGraph) -> LocalOptimum:
    """The same optimum at the finer keyframes of another graph."""
    coarse = coarse.graph.run_em(coarse.states, coarse.em_weights, _REFINING_ROUNDS)
    states = interpolated(coarse.states, coarse.graph.keyframes, graph.keyframes)
    first = replace(graph.initial_em_weights(), range_weight=coarse.em_weights.range_weight)
    near = graph.with_sigma_of(coarse.graph).run_em(states, first, _REFINING_ROUNDS)
    return _measured_again(near, _REFINING_ROUNDS)


def _measured_again(optimum: LocalOptimum, rounds: int) -> LocalOptimum:
    """The optimum after more EM rounds with ranges' sigmas and weights measured on its residuals.

    Where errors in line of sight are larger than noise and many ranges are NLOS, some of the others are NLOS after all,
    and ranges count for less.
    """
    states = optimum.states
    graph = optimum.graph.with_measured_sigma(states, optimum.em_weights.range_weight)
    em_weights, _ = graph.e_step(states, optimum.em_weights)
    em_weights = graph.with_range_weights(states, em_weights)
    beyond = 1.0 - (graph.measurements.sigma / graph.sigma) ** 2
    _, inlier_probability = graph.inlier_probability(states, em_weights)
    share = float(1.0 - inlier_probability.mean()) if len(inlier_probability) else 0.0
    worth = 1.0 / (1.0 + graph.parameters.ranges.reflection_confusion * 4.0 * share * (1.0 - share) * beyond)
    return graph.run_em(states, replace(em_weights, range_weight=worth * em_weights.range_weight), rounds)


def other_heights(optimum: LocalOptimum, begun: Sequence[Array] = ()) -> list[LocalOptimum]:
    """Optima beside one with measured weights that differ from it in heights; `begun` (k,) m are some found before.

    At given walks, scales and biases an optimum's own heights are often the only ones: these have taken up what other
    heights would explain. So SLAM's own heights begin anew, and a few steps are made with all that is free.
    """
    graph, states, em_weights = optimum.graph, optimum.states, optimum.em_weights
    begin = _with_slam_heights(optimum)
    found: list[LocalOptimum] = []
    known = [states.anchor_poses[graph.free, 2]]
    for frames in _begun_heights(optimum, begun):
        # A height far from the others' is one that the prior holds but loosely.
        near = graph.optimised(
            begin._replace(anchor_poses=frames), states.anchor_poses, em_weights, 1.0, _DRAWN_STEPS, _DRAWN_GAIN
        )
        heights = near.anchor_poses[graph.free, 2]
        if any(np.abs(heights - others).max() < _SAME_HEIGHT for others in known):
            continue
        known.append(heights)
        found.append(graph.run_em(near, em_weights, _FIRST_ROUNDS))
    return found


def _with_slam_heights(optimum: LocalOptimum) -> States:
    """The states with the walks' own heights as SLAM has them."""
    walks = [
        np.column_stack([at[:, :2], of_user.place[:, 2], at[:, 3]])
        for at, of_user in zip(optimum.states.keyframe_poses, optimum.graph.keyframes, strict=True)
    ]
    return optimum.states._replace(keyframe_poses=walks)


def otherwise_held(optimum: LocalOptimum) -> Iterator[LocalOptimum]:
    """Optima beside one with measured weights in which one device is held as usual and is not in that, or the reverse.

    Each device that is held as usual is put as much higher, and lower, as others are. Where ranges exclude that, all
    else at its best, it is not looked at any further. Where it lies higher or lower than usual already it may be held
    otherwise just there: that it is half a metre lower excludes that it is a metre lower. All of whom that is so may be
    held otherwise at once: while the others are held as usual, none of them gains by it. Where it lies is asked of its
    walk's end, since what its height explains may have passed for a slip of its SLAM.
    """
    begin = _with_slam_heights(optimum)
    graph, frames, em_weights = optimum.graph, optimum.states.anchor_poses, optimum.em_weights
    level = graph.mean_height(frames, em_weights.height_weight)
    those = [u for u in graph.active_users if graph.other_height_sigma[u] > graph.height_sigma[u]]
    if len(those) <= 2 and graph.reference in those:  # which of the two it is makes no difference
        those.remove(graph.reference)
    most = optimum.cost + graph.parameters.integrity.cost_excluded_nlos
    at_last = frames[:, 2] + np.exp(optimum.states.calibration[:, SCALE]) * np.array(
        [
            own[-1, 2] - of_slam[-1, 2]
            for own, of_slam in zip(optimum.states.keyframe_poses, begin.keyframe_poses, strict=True)
        ]
    )
    far = np.abs(at_last - level) > _UNUSUAL * graph.height_sigma
    others = graph.held_as_usual & far & np.isin(np.arange(len(far)), those)
    if np.count_nonzero(others) > 1:
        held, there = graph.with_held_as_usual(graph.held_as_usual & ~others), frames.copy()
        there[others, 2] = at_last[others]
        there[:, 2] -= there[graph.reference, 2]
        height_weight, _ = held.height_weights(there)
        weights = replace(em_weights, height_weight=height_weight)
        yield held.run_em(begin._replace(anchor_poses=there), weights, _FIRST_ROUNDS)
    for u in those:
        usual = graph.held_as_usual.copy()
        usual[u] = not usual[u]
        held, sigma = graph.with_held_as_usual(usual), float(graph.other_height_sigma[u])
        known: list[LocalOptimum] = []
        here = (float(at_last[u]) - level,) if far[u] else ()
        for above in (0.0,) if usual[u] else (*here, sigma, -sigma):
            there = frames.copy()
            there[u, 2] = level + above
            there[:, 2] -= there[graph.reference, 2]
            height_weight, _ = held.height_weights(there)
            weights, near = replace(em_weights, height_weight=height_weight), begin._replace(anchor_poses=there)
            if abs(above) == sigma:
                moved = [v for v in those if v != u] if u == graph.reference else [u]
                pinned = held.with_pinned_heights(there[:, 2], moved)
                near = pinned.optimised(near, frames, weights, 1.0, _PINNED_STEPS, _DRAWN_GAIN)
                if held.e_step(near, weights)[1] > most:
                    continue
            other = held.run_em(near, weights, _FIRST_ROUNDS)
            if not any(np.abs(other.frames - one.frames)[graph.free, 2].max() < _SAME_HEIGHT for one in known):
                known.append(other)
        yield from known


def _begun_heights(optimum: LocalOptimum, begun: Sequence[Array]) -> Iterator[Array]:
    """Frames (k, 4) with other heights: those `begun`, static radios mirrored one by one, and draws, each both ways."""
    graph, frames = optimum.graph, optimum.states.anchor_poses
    for heights in begun:
        relative = heights - heights[graph.reference]
        if np.abs(relative - frames[:, 2])[graph.free].max() > _SAME_HEIGHT:
            yield np.column_stack([frames[:, :2], relative, frames[:, 3]])
    static = np.array([user.static for user in graph.users])
    surveyed = graph.problem.surveyed
    mirrored = height_mirrors(graph.to_rigid_ranges(optimum.states), frames, graph.reference, surveyed)
    for u in graph.free:
        if static[u] and not surveyed[u]:
            yield mirrored[graph.active_users.index(u)]
    if static[graph.free].all():
        return
    random = np.random.default_rng(_SEED)
    for sigmas in _DRAWN_SIGMAS:
        drawn = sigmas * graph.height_sigma * random.standard_normal(len(static))
        level = 0.0
        if surveyed.any():  # a survey's zero is where it is, and so is the level of all who move
            drawn[graph.reference], level = 0.0, graph.mean_height(frames, optimum.em_weights.height_weight)
        for heights in (drawn, -drawn):
            out = frames.copy()
            out[:, 2] = np.where(static, frames[:, 2], level + heights) - heights[graph.reference]
            yield out


def other_places(optimum: LocalOptimum) -> list[LocalOptimum]:
    """Optima beside one with measured weights in which one user is somewhere else.

    Among NLOS ranges the search, with wide sigmas and SLAM's own walks, may have left out where one of them is. Each is
    looked for anew beside all the others, as these are at the optimum.
    """
    graph, states, em_weights = optimum.graph, optimum.states, optimum.em_weights
    begin = replace(em_weights, nlos_odds=graph.measurements.nlos_odds)
    rigid = graph.rigid_problem(states)
    found: list[LocalOptimum] = []
    known = [optimum.frames]
    for user in graph.free:
        others = states.anchor_poses.copy()
        others[user] = np.nan
        for candidate in extend(rigid, [Candidate(others, 0.0)], user)[:_MOST_PLACES]:
            off = difference(candidate.frames[user], states.anchor_poses[user])
            if np.linalg.norm(off[:3]) < _ELSEWHERE and abs(off[3]) < _ELSEWHERE:
                continue
            near = graph.run_em(states._replace(anchor_poses=candidate.frames), begin, _FIRST_ROUNDS)
            if near.cost > optimum.cost + graph.parameters.search.hopeless_cost or near.graph.is_known(
                near.states, known
            ):
                continue
            other = near.graph.run_em(near.states, near.em_weights, _ROUNDS, known=known)
            known.append(other.frames)
            if other.cost < optimum.cost + graph.parameters.integrity.cost_excluded_nlos:
                found.append(other)
    return found


def compare(
    found: list[LocalOptimum], best: LocalOptimum, others_in_height: Sequence[LocalOptimum] = ()
) -> list[LocalOptimum]:
    """The optima that explain the ranges: the refined `best`, then those of the others not excluded by their cost.

    `best` is `found[0]` refined. Costs are compared at the keyframes of `found`, with the range weights measured at the
    best one.
    """
    if len(found) == 1 and not others_in_height:
        return [best]
    likely = [s for s in found if s.cost < found[0].cost + best.graph.parameters.search.hopeless_cost][:_MOST_COMPARED]
    compared = []
    for s in (*likely, *others_in_height):
        em_weights = replace(s.em_weights, range_weight=best.em_weights.range_weight)
        compared.append(s.graph.with_sigma_of(best.graph).run_em(s.states, em_weights, _FIRST_ROUNDS))
    first, *others = compared
    return [best._replace(cost=first.cost), *sorted(not_excluded(first, others), key=by_cost)]


def not_excluded(best: LocalOptimum, others: Sequence[LocalOptimum]) -> list[LocalOptimum]:
    """Those of the others, of the same ranges and range weights as the best one, that their cost does not exclude.

    Where people walk straight lines, ranges do not distinguish a placement from its mirror image: what drift has bent
    favours one or the other, as the ranges' noise will have it. The difference of the two costs is then normal about 0,
    with the norm of the difference of their whitened residuals e as standard deviation: a cost's derivative by the
    ranges' noise is -e (envelope theorem). An optimum is excluded where the difference is no such chance. Of optima
    that differ in heights alone no walk is a mirror image, and the evidence decides.
    """
    limits = best.graph.parameters.integrity
    nlos = nlos_share(best) > best.graph.parameters.search.doubtful_share
    least = limits.cost_excluded_nlos if nlos else limits.cost_excluded
    own = _scores(best)
    root = np.sqrt(best.em_weights.range_weight)
    by_chance = [float(np.linalg.norm(root * (_scores(s) - own))) for s in others]
    here, out = best.frames, []
    for s, sigma in zip(others, by_chance, strict=True):
        off = np.abs(difference(s.frames, here))
        level = np.nanmax(np.hypot(off[:, 0], off[:, 1])) < limits.largest_error
        level = level and np.nanmax(off[:, 3]) < limits.largest_yaw_error
        if s.cost - best.cost <= (limits.cost_excluded if level else max(least, limits.cost_excluded_sigmas * sigma)):
            out.append(s)
    return out


def _scores(optimum: LocalOptimum) -> Array:
    """(n,) derivative of the cost of each range, at weight 1, by its whitened residual."""
    graph = optimum.graph
    weight, _ = graph.inlier_probability(optimum.states, optimum.em_weights)
    return weight * graph.residuals(optimum.states) / graph.sigma
