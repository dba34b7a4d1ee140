"""Statistical tests of the paper's evaluation, by statsmodels and scipy."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from experiments.common.study import Interval
from synchronizar.arrays import Array

SIGNIFICANT = 0.05


def two_way(values: Array, rows: str, columns: str) -> str:
    """A two-way analysis of variance (type II) of values (rows, columns, repeats)."""
    import pandas
    from statsmodels.formula.api import ols
    from statsmodels.stats.anova import anova_lm

    row, column, _ = np.indices(values.shape)
    table = pandas.DataFrame({"value": values.ravel(), "row": row.ravel(), "column": column.ravel()})
    analysis = anova_lm(ols("value ~ C(row) * C(column)", table).fit(), typ=2)
    names = {"C(column)": columns, "C(row)": rows, "C(row):C(column)": "both together"}
    return "; ".join(
        f"{name} F = {analysis['F'][term]:.2f}, p = {analysis['PR(>F)'][term]:.2g}" for term, name in names.items()
    )


def one_way(groups: Array) -> str:
    """A one-way analysis of variance of groups (k, n)."""
    from scipy.stats import f_oneway

    found = f_oneway(*groups)
    return f"F = {found.statistic:.2f}, p = {found.pvalue:.2g}"


def corrected(groups: Array) -> dict[tuple[int, int], float]:
    """The p values of Welch's t-tests between all pairs of groups (k, n), corrected by Bonferroni."""
    from scipy.stats import ttest_ind
    from statsmodels.stats.multitest import multipletests

    pairs = list(combinations(range(len(groups)), 2))
    p = multipletests([ttest_ind(groups[a], groups[b], equal_var=False).pvalue for a, b in pairs], method="bonferroni")[
        1
    ]
    return dict(zip(pairs, p.tolist(), strict=True))


def pairs_told(groups: Array, values: Sequence[float]) -> str:
    """Which groups (k, n) differ; `values` (k,) name them."""
    return "; ".join(
        f"{values[a]} and {values[b]} {'differ' if p < SIGNIFICANT else 'do not'} (p = {p:.2g})"
        for (a, b), p in corrected(groups).items()
    )


def claim(what: str, found: Interval, bound: float, unit: str) -> str:
    """Whether what the paper says to be below a bound is: with its whole interval, in part, or not."""
    said = "reproduced" if found.high < bound else "NOT reproduced" if found.low > bound else "undecided"
    told = f"{found.value:.3f} ({found.low:.3f} to {found.high:.3f}) {unit}"
    return f"{what}: {told}, the paper below {bound} {unit}: {said}"
