"""Panels of each device's calibration (scale, radio bias, clock offset) and of its SLAM's drift noise."""

from __future__ import annotations

from math import hypot
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from synchronizar.data.registration import UserRegistration
from synchronizar.parameters import Parameters
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.plots.style import Style, short

SIGMAS = 2.0
"""Half length of error bars and half width of the priors' bands, in sigma."""
DEVICE, PRIOR_DOMINATED = "black", "0.55"
FEWEST_ROWS, MOST_ROWS = 8, 44
ROWS_IN_LARGE_PRINT = 26


class Kind(NamedTuple):
    """One calibration value of a device, and how its panel shows it."""

    name: str
    """Its name in UserRegistration.prior_dominated."""
    title: str
    unit: float
    """Unit of the panel in SI units: 1e-3 for thousandths."""
    form: str
    neutral: float
    """Value of an ideal device."""
    prior: tuple[float, float]
    """Lower and upper edge of the prior's band of SIGMAS sigma."""


def kinds(model: Parameters) -> tuple[Kind, Kind, Kind]:
    """Scale, range bias and clock offset, with the model's priors."""
    # One device before any range: its own deviation and the one that all devices share, in quadrature.
    log_scale = SIGMAS * hypot(model.devices.scale_sigma, model.devices.scale_common_sigma)
    bias = SIGMAS * hypot(model.devices.bias_sigma, model.devices.bias_common_sigma)
    clock = SIGMAS * hypot(model.devices.clock_sigma, model.devices.clock_common_sigma)
    return (
        Kind("scale", "Scale of SLAM", 1.0, ".3f", 1.0, (float(np.exp(-log_scale)), float(np.exp(log_scale)))),
        Kind("range_bias", "Bias of the radio (m)", 1.0, ".3f", 0.0, (-bias, bias)),
        Kind("clock_offset", "Clock offset (ms)", 1e-3, ".0f", 0.0, (-clock, clock)),
    )


def rows_shown(answer: Answer) -> int:
    """Number of rows; one more where some users are not shown."""
    return min(len(answer.names), MOST_ROWS) + (len(answer.names) > MOST_ROWS)


def draw_names(ax: Axes, answer: Answer, styles: dict[str, Style]) -> None:
    """Draw the users' names for all panels, each behind a sample of its line."""
    for row, name in enumerate(answer.names[:MOST_ROWS]):
        style = styles[name]
        if answer.registration.users[name].static:
            ax.plot(0.1, row, "^", color=style.colour, markersize=6)
        else:
            ax.plot([0.0, 0.2], [row, row], linestyle=style.dashes, color=style.colour, linewidth=2.0)
        ax.text(0.26, row, short(name), color=style.ink, fontsize=_font_size(answer), va="center")
    if len(answer.names) > MOST_ROWS:
        ax.text(0.26, MOST_ROWS, f"and {len(answer.names) - MOST_ROWS} more", fontsize=_font_size(answer), va="center")
    ax.set(xlim=(0.0, 1.0), ylim=_limits(answer))
    ax.axis("off")


def draw_estimates(ax: Axes, answer: Answer, kind: Kind) -> None:
    """Draw one calibration value of each device with its error bar, over the prior's band."""
    ax.axvspan(kind.prior[0] / kind.unit, kind.prior[1] / kind.unit, color="0.93", zorder=0)
    ax.axvline(kind.neutral / kind.unit, color="0.75", linewidth=0.8, zorder=1)
    shown = list(kind.prior)
    for row, name in enumerate(answer.names[:MOST_ROWS]):
        user = answer.registration.users[name]
        value = _value(user, kind)
        if value is None:
            _write(ax, row, "-", PRIOR_DOMINATED, _font_size(answer))
        else:
            reach = min(_reach(user, kind), kind.prior[1] - kind.prior[0])
            shown += [value - reach, value + reach]
            _draw_estimate(ax, row, user, kind, value, _font_size(answer))
    margin = 0.05 * (max(shown) - min(shown))
    ax.set(
        xlim=((min(shown) - margin) / kind.unit, (max(shown) + margin) / kind.unit),
        ylim=_limits(answer),
        yticks=[],
        title=kind.title,
    )
    ax.tick_params(labelsize=8)


def draw_slam_noise(ax: Axes, answer: Answer) -> None:
    """Draw the factors of each SLAM's drift noise over the model's: of position (dots) and of heading (diamonds)."""
    ax.axvline(1.0, color="0.75", linewidth=0.8, zorder=1)
    shown = [0.5, 2.0]
    for row, name in enumerate(answer.names[:MOST_ROWS]):
        noise = answer.registration.users[name].slam_noise
        if noise is None:
            _write(ax, row, "-", PRIOR_DOMINATED, _font_size(answer))
            continue
        shown += noise
        for value, marker in zip(noise, "oD", strict=True):
            ax.plot(value, row, marker, color=DEVICE, markerfacecolor="none", markersize=5)
        _write(ax, row, f"{noise[0]:.2f}, {noise[1]:.2f}", DEVICE, _font_size(answer))
    ax.set_xscale("log", base=2)
    ax.set(
        xlim=(min(shown) / 1.2, max(shown) * 1.2),
        ylim=_limits(answer),
        yticks=[],
        title="Drift of SLAM (×)",
        xlabel="○ place, ◇ heading;\n1: as the model says",
    )
    ax.xaxis.label.set_fontsize(9)
    ax.xaxis.set_major_formatter("{x:g}")
    ax.tick_params(labelsize=8)


def _value(user: UserRegistration, kind: Kind) -> float | None:
    """The user's value; None where it is disconnected, or static and the value is not the range bias."""
    if user.common_from_user is None or (user.static and kind.name != "range_bias"):
        return None
    return {
        "scale": user.common_from_user.scale,
        "range_bias": user.range_bias,
        "clock_offset": user.clock_offset,
    }[kind.name]


def _reach(user: UserRegistration, kind: Kind) -> float:
    """Half length of its error bar; 0 where its sigma is unknown."""
    sigma = 0.0 if user.calibration_sigma is None else float(getattr(user.calibration_sigma, kind.name))
    return SIGMAS * sigma if np.isfinite(sigma) else 0.0


def _draw_estimate(ax: Axes, row: int, user: UserRegistration, kind: Kind, value: float, font_size: float) -> None:
    """Draw one value and write it beside the panel; hollow and grey where the prior dominates it."""
    hollow = kind.name in user.prior_dominated
    colour = PRIOR_DOMINATED if hollow else DEVICE
    reach = _reach(user, kind) / kind.unit
    ax.errorbar(
        value / kind.unit,
        row,
        xerr=reach or None,
        fmt="o",
        color=colour,
        markerfacecolor="white" if hollow else colour,
        markersize=5,
        capsize=2.5,
        linewidth=1.2,
    )
    text = format(value / kind.unit, f"z{kind.form}")
    _write(ax, row, f"{text} ±{reach:{kind.form}}" if reach else text, colour, font_size)


def _write(ax: Axes, row: int, text: str, colour: str, font_size: float) -> None:
    """Write a number beside the panel."""
    ax.text(1.03, row, text, transform=ax.get_yaxis_transform(), color=colour, fontsize=font_size, va="center")


def _limits(answer: Answer) -> tuple[float, float]:
    """Limits of the y axis; the first user is on top."""
    return max(rows_shown(answer), FEWEST_ROWS) - 0.5, -0.5


def _font_size(answer: Answer) -> float:
    return 8.5 if rows_shown(answer) <= ROWS_IN_LARGE_PRINT else 6.5
