"""What came of all scenes: a table by family, the list of what was wrong, a picture."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

from matplotlib.axes import Axes

from experiments.common.study import COLOURS, figure
from experiments.integrity.families import FAMILIES
from experiments.integrity.judging import Judged
from experiments.integrity.scoring import Off, share_bounds
from synchronizar.data.registration import State

LONG_S = 1.0
"""s: what is wrong for longer was not seen at once."""
ALL = "all"
AT_ONCE, LIVE = "at once", "while walking"
AIM = 1.0 / 300.0
PLACED_AIM = 0.9


class Share(NamedTuple):
    """So many of n."""

    how_many: int
    n: int

    @property
    def value(self) -> float:
        """NaN of none."""
        return self.how_many / self.n if self.n else float("nan")

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper, 95 % each."""
        return share_bounds(self.how_many, self.n)


class Group(NamedTuple):
    """Scenes taken together."""

    name: str
    scenes: list[Judged]

    @property
    def wrong(self) -> dict[str, Share]:
        """Of verdicts and of episodes in which a user is called registered, how many are wrong."""
        verdicts = [v.off.wrong for s in self.scenes for v in s.verdicts if v.state is State.REGISTERED and v.off]
        episodes = [e.wrong for s in self.scenes for e in s.episodes]
        return {AT_ONCE: Share(sum(verdicts), len(verdicts)), LIVE: Share(sum(episodes), len(episodes))}

    @property
    def wrong_for_long(self) -> Share:
        """Of the episodes."""
        episodes = [e.off_s > LONG_S for s in self.scenes for e in s.episodes]
        return Share(sum(episodes), len(episodes))

    @property
    def scenes_wrong(self) -> dict[str, Share]:
        """Of the scenes, how many have any wrong: the users and episodes of one are not independent."""
        return {way: Share(sum(any_wrong(s)[way] for s in self.scenes), len(self.scenes)) for way in (AT_ONCE, LIVE)}

    @property
    def said(self) -> dict[str, Share]:
        """Of those whom maximum likelihood places, how many are registered, at last where people walk."""
        return self._said(alone=False)

    @property
    def said_alone(self) -> dict[str, Share]:
        """The same of those of whom it knows no other placement."""
        return self._said(alone=True)

    def _said(self, alone: bool) -> dict[str, Share]:
        well = [v for s in self.scenes for v in s.verdicts if v.well and (v.alone or not alone)]
        return {
            AT_ONCE: Share(sum(v.state is State.REGISTERED for v in well), len(well)),
            LIVE: Share(sum(v.live is State.REGISTERED for v in well), len(well)),
        }


def any_wrong(scene: Judged) -> dict[str, bool]:
    """Whether anybody was called registered wrongly."""
    at_once = any(v.state is State.REGISTERED and v.off is not None and v.off.wrong for v in scene.verdicts)
    return {AT_ONCE: at_once, LIVE: any(e.wrong for e in scene.episodes)}


def groups_of(scenes: Sequence[Judged]) -> list[Group]:
    """By family, and all."""
    by_family = [Group(name, [s for s in scenes if s.family == name]) for name in FAMILIES]
    return [*(group for group in by_family if group.scenes), Group(ALL, list(scenes))]


def row_of(group: Group) -> dict[str, Any]:
    """A line of the table; bounds are upper ends of one-sided 95 % intervals (Clopper and Pearson 1934)."""
    wrong, scenes, said, alone = group.wrong, group.scenes_wrong, group.said, group.said_alone
    row: dict[str, Any] = {"family": group.name, "scenes": len(group.scenes)}
    for way in (AT_ONCE, LIVE):
        row[f"{way}: registered"] = wrong[way].n
        row[f"{way}: wrong"] = wrong[way].how_many
        if way == LIVE:
            row[f"{way}: wrong for > {LONG_S:g} s"] = group.wrong_for_long.how_many
        row[f"{way}: at most"] = wrong[way].bounds[1]
        row[f"{way}: scenes with any"] = scenes[way].how_many
    row["placed by ML"] = said[AT_ONCE].n
    for way in (AT_ONCE, LIVE):
        row[f"{way}: of these registered"] = said[way].value
    row["without other placements"] = alone[AT_ONCE].n
    for way in (AT_ONCE, LIVE):
        row[f"{way}: of them registered"] = alone[way].value
    row["crashed"] = sum(bool(s.crashed) for s in group.scenes)
    row["CPU s a scene"] = sum(s.cpu for s in group.scenes) / len(group.scenes)
    return row


def wrong_ones(scenes: Sequence[Judged]) -> list[dict[str, Any]]:
    """What was called registered wrongly, the longest first, with what plays it again."""
    found = []
    for s in scenes:
        scene = {"family": s.family, "seed": s.seed, "kinds": list(s.kinds)}
        for v in s.verdicts:
            if v.state is State.REGISTERED and v.off is not None and v.off.wrong:
                found.append(scene | {"how": AT_ONCE, "user": v.user} | _numbers(v.off))
        for e in s.episodes:
            if e.wrong:
                lasts = {"begin": e.begin, "end": e.end, "wrong_s": e.off_s}
                found.append(scene | {"how": LIVE, "user": e.user} | _numbers(e.off) | lasts)
    return sorted(found, key=lambda w: (w["how"], -float(w.get("wrong_s", 0.0)), -w["error_m"]))


def _numbers(off: Off) -> dict[str, float]:
    return {"error_m": off.place, "yaw_rad": off.yaw, "sigma_m": off.sigma}


def command(wrong: dict[str, Any]) -> str:
    """What solves its scene again and tells everything."""
    return f'python -m experiments.integrity --scene "{wrong["family"]}" {wrong["seed"]}'


def line_of_wrong(wrong: dict[str, Any]) -> str:
    """One line."""
    lasts = f", {wrong['wrong_s']:.1f} s of {wrong['begin']:.1f} to {wrong['end']:.1f} s" if "begin" in wrong else ""
    error = f"{wrong['error_m']:.2f} m, {wrong['yaw_rad']:.2f} rad at {wrong['sigma_m']:.2f} m (1 sigma)"
    mixed = "" if len(wrong["kinds"]) == 1 else f" ({' + '.join(wrong['kinds'])})"
    return f"{wrong['how']}: {wrong['family']}{mixed} {wrong['seed']} {wrong['user']}: {error}{lasts}"


def written(scenes: Sequence[Judged], settings: dict[str, Any], file: Path) -> str:
    """The whole report as text; FILE.txt, FILE.json and FILE.png are written."""
    groups = groups_of(scenes)
    rows, wrong = [row_of(group) for group in groups], wrong_ones(scenes)
    crashed = [f"crashed: {s.family} {s.seed}: {s.crashed}" for s in scenes if s.crashed]
    text = "\n".join([_as_text(rows), "", *map(line_of_wrong, wrong), *crashed, ""])
    file.parent.mkdir(exist_ok=True, parents=True)
    file.with_suffix(".txt").write_text(text, encoding="utf-8")
    told = {"settings": settings, "rows": rows, "wrong": [w | {"command": command(w)} for w in wrong]}
    file.with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    draw(groups, file.with_suffix(".png"))
    return text


def _as_text(rows: list[dict[str, Any]]) -> str:
    """A table whose head is wrapped."""
    heads = [wrap(name.replace(":", ""), 11) for name in rows[0]]
    height = max(map(len, heads))
    stacked = [[*[""] * (height - len(head)), *head] for head in heads]
    lines = [*map(list, zip(*stacked, strict=True)), *([_cell(value) for value in row.values()] for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(heads))]
    return "\n".join(
        "  ".join([line[0].ljust(widths[0]), *(t.rjust(w) for t, w in zip(line[1:], widths[1:], strict=True))])
        for line in lines
    )


def _cell(value: object) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def draw(groups: Sequence[Group], file: Path) -> None:
    """By family: the share that is wrong, and of those who could be placed the share that is registered."""
    made, axes = figure(columns=2, height=0.6 + 0.17 * len(groups))
    panels: list[tuple[Axes, str, float, Callable[[Group], dict[str, Share]]]] = [
        (axes[0, 0], "share of those called registered that is wrong", AIM, lambda group: group.wrong),
        (axes[0, 1], "share registered of those whom ML places", PLACED_AIM, lambda group: group.said),
    ]
    for ax, title, aim, shares in panels:
        for way, colour, aside in ((AT_ONCE, COLOURS["joint"], -0.15), (LIVE, COLOURS["pairwise"], 0.15)):
            for y, group in enumerate(groups):
                share = shares(group)[way]
                if share.n:
                    low, high = share.bounds
                    ax.plot([low, high], [y + aside] * 2, color=colour, linewidth=1.0)
                    ax.plot(share.value, y + aside, "o", color=colour, markersize=3)
            ax.plot([], [], "o-", color=colour, label=way, markersize=3, linewidth=1.0)
        ax.axvline(aim, color=COLOURS["bound"], linewidth=0.6, linestyle="--")
        ax.set(title=title, ylim=(len(groups) - 0.5, -0.5))
        ax.grid(axis="y", visible=False)
    axes[0, 0].set_yticks(range(len(groups)), [group.name for group in groups])
    axes[0, 0].set_xscale("symlog", linthresh=0.01, linscale=0.5)
    axes[0, 0].set(xlim=(0.0, 1.0))
    axes[0, 0].set_xticks([0.0, 0.01, 0.1, 1.0], ["0", "0.01", "0.1", "1"])
    axes[0, 1].set_yticks(range(len(groups)), [])
    axes[0, 1].set(xlim=(-0.02, 1.02))
    handles, labels = axes[0, 0].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    made.savefig(file, dpi=200)
