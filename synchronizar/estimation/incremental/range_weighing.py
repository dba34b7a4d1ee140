"""How the ranges of users who are followed count: NLOS odds given one another, weights, sizes of errors."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from synchronizar._core import NlosMixture, burst_nlos_odds_of_pairs, mixture_terms
from synchronizar.arrays import Array
from synchronizar.estimation.incremental.slot_ranges import (
    DISTANCE,
    LINK,
    NLOS_ODDS,
    ODDS,
    SIGMA,
    SLOT,
    USER_I,
    USER_J,
    WEIGHT,
    SlotRanges,
    T,
)
from synchronizar.estimation.incremental.slot_states import SlotStates
from synchronizar.graph.priors import bursts_of, nlos_mixture
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pairs
from synchronizar.preprocessing.range_weights import measured_correlation, measured_range_weights, measured_sizes

_SUREST = 27.0  # log odds that a range is NLOS, at most
_CHANGED = 0.1  # of a range's probability of line of sight, or relative of its weight: its slot is taken in anew
_FIRST_WEIGHT = 0.1  # of a range of a pair that has none yet: what it will be worth among so many


class RangeWeighing:
    """Judges ranges as more of them come."""

    KEPT: ClassVar[tuple[str, ...]] = ("weight", "size")

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._loss: NlosMixture = nlos_mixture(parameters)
        self.weight: dict[tuple[int, int], float] = {}
        """What a range of a pair was worth lately."""
        self.size: dict[tuple[int, int], float] = {}
        """How large a pair's line-of-sight errors are, of what the model says."""

    def weight_of(self, i: int, j: int) -> float:
        """What a further range of a pair is worth."""
        return self.weight.get((i, j), _FIRST_WEIGHT)

    def judge(self, ranges: SlotRanges, states: SlotStates, users: int, first: int) -> list[int]:
        """NLOS odds of the ranges from slot `first` on, anew.

        Only slots are changed in which odds are others by enough; returns them. A burst shows by how large
        line-of-sight errors are, which the model has as large as reflections make them.
        """
        sizes = np.ones((users, users))
        for (i, j), size in self.size.items():
            sizes[i, j] = size
        bursts = bursts_of(self._parameters)
        slots, which, odds = states.judged(ranges.rows, first, sizes, self._loss, bursts, _SUREST, _CHANGED)
        if slots:
            ranges.rows[which, NLOS_ODDS] = odds
        return slots

    def weigh(self, ranges: SlotRanges, states: SlotStates, users: int, first: int) -> list[int]:
        """As `judge`, and weights and sizes of errors anew.

        Sizes are measured on ranges that pass by the model's own sigma: on those that pass by their own measure they
        would shrink without end.
        """
        rows = ranges.rows
        which = np.flatnonzero(rows[:, SLOT] >= first)
        if not len(which):
            return []
        which = which[np.lexsort([rows[which, T], rows[which, USER_J], rows[which, USER_I]])]
        part = rows[which]
        t, sigma, prior, before = (np.ascontiguousarray(part[:, c]) for c in (T, SIGMA, ODDS, NLOS_ODDS))
        whitened = states.residuals(part) / sigma
        change = np.flatnonzero(np.diff(part[:, USER_I]) + users * np.diff(part[:, USER_J]) != 0.0) + 1
        bounds = np.concatenate([[0], change, [len(part)]]).astype(np.int32)
        bursts = bursts_of(self._parameters)
        pair = [(i, j) for i, j in part[bounds[:-1]][:, [USER_I, USER_J]].astype(int).tolist()]
        model, _ = burst_nlos_odds_of_pairs(bounds, t, whitened, sigma, prior, self._loss, bursts)
        _, robust, _ = mixture_terms(whitened, sigma, model, self._loss)
        size = measured_sizes(bounds, self._nominal(sigma) / sigma, whitened, robust, self._parameters)
        self.size.update(zip(pair, size[bounds[:-1]].tolist(), strict=True))
        odds, _ = burst_nlos_odds_of_pairs(bounds, t, whitened / size, sigma * size, prior, self._loss, bursts)
        # The loss has the model's sigma: at these residuals it is to say what the chain says.
        narrower = 0.5 * np.minimum(whitened, 0.0) ** 2 * (size**-2 - 1.0)
        odds = np.minimum(odds * size * np.exp(np.minimum(narrower, _SUREST)), np.exp(_SUREST))
        weight = self._measured_weights(part, whitened, odds)
        inlier, inlier_before = (mixture_terms(whitened, sigma, of, self._loss)[2] for of in (odds, before))
        changed = np.abs(inlier - inlier_before) > _CHANGED
        changed |= np.abs(np.log(weight / part[:, WEIGHT])) > 2.0 * _CHANGED
        slots: list[int] = np.unique(part[changed, SLOT]).astype(int).tolist()
        taken = np.isin(part[:, SLOT], slots)  # the others keep what they were put with
        rows[which[taken], NLOS_ODDS], rows[which[taken], WEIGHT] = odds[taken], weight[taken]
        return slots

    def _nominal(self, sigma: Array) -> Array:
        """(n,) m: 1 sigma that recordings give, of ranges that have this `sigma` (n,) by the model."""
        return np.sqrt(np.maximum(sigma**2 - self._parameters.ranges.multipath_sigma**2, 1e-12))

    def _measured_weights(self, part: Array, whitened: Array, odds: Array) -> Array:
        """(n,) range weights of ranges (n, columns) sorted by pair, each as if its later neighbours had come."""
        _, weight, _ = mixture_terms(whitened, part[:, SIGMA].copy(), odds, self._loss)
        none = np.zeros((len(part), 3))
        nominal = self._nominal(part[:, SIGMA])
        i, j = part[:, USER_I].astype(np.int32), part[:, USER_J].astype(np.int32)
        t = part[:, T].copy()
        measurements = RangeMeasurements(
            i, j, t, none, none, part[:, DISTANCE].copy(), nominal, part[:, ODDS].copy(), np.zeros(len(part), np.int32)
        )
        links = part[:, LINK].astype(np.int32)
        m = self._parameters
        correlation = measured_correlation(measurements, whitened, weight, links, m.ranges.multipath_duration, m)
        out = measured_range_weights(measurements, nominal / part[:, SIGMA], weight, correlation, m)
        recent = t > t.max() - self._parameters.ranges.multipath_duration
        for pair in pairs(measurements):
            k = pair.measurements
            of_pair, new = out[k], recent[k]
            settled = float(of_pair[~new].mean()) if (~new).any() else float(of_pair.min())
            out[k] = np.where(new, np.minimum(of_pair, settled), of_pair)
            self.weight[pair.i, pair.j] = settled
        return out
