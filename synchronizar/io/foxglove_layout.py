"""Writes a layout for Foxglove beside an MCAP file: what is imported by Layouts, Import from file.

On the left everybody from above and the ranges between them, on the right the residuals, and of a replay the states and
how well each place was known.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from synchronizar.errors import os_faults

SUFFIX = ".layout.json"


def layout_of(mcap: Path) -> Path:
    """Where the layout of an MCAP file stands: `walk.layout.json` beside `walk.mcap`."""
    return mcap.with_suffix(SUFFIX)


def write_layout(mcap: Path, tracks: Sequence[str], states: Sequence[str], frame: str | None) -> None:
    """Write the layout of a file with these tracks, states over time of these users, in the frame if there is one.

    Raises InputError where it cannot be written.
    """
    file = layout_of(mcap)
    with os_faults(file):
        file.write_text(json.dumps(layout(tracks, states, frame), indent=1) + "\n", encoding="utf-8")


def layout(tracks: Sequence[str], states: Sequence[str], frame: str | None) -> dict[str, Any]:
    """The layout as Foxglove exports one: panels by id, and how they divide the window."""
    panels: dict[str, Any] = {"3D!map": _map(tracks, frame), "Plot!residuals": _plot("Residuals (m)", _residuals())}
    right: Any = "Plot!residuals"
    if states:
        panels["StateTransitions!states"] = {
            "isSynced": True,
            "paths": [
                {"value": f"{_topic('/states/', name)}.state", "label": name, "timestampMethod": "receiveTime"}
                for name in states
            ],
        }
        panels["Plot!sigma"] = _plot("1 sigma in the plane (m)", _lines(states, "sigma_xy"))
        right = _split("StateTransitions!states", _split("Plot!sigma", right, "column", 50), "column", 40)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": _split("3D!map", right, "row", 58),
    }


def _split(first: Any, second: Any, direction: str, share: int) -> dict[str, Any]:
    return {"first": first, "second": second, "direction": direction, "splitPercentage": share}


def _map(tracks: Sequence[str], frame: str | None) -> dict[str, Any]:
    """Seen from straight above, following the frame that all are in; of several frames the first track's."""
    topics: dict[str, Any] = {f"/tracks/{name}": {"visible": True, "type": "line"} for name in tracks}
    topics |= {"/scene": {"visible": True}, "/range_lines": {"visible": True}}
    return {
        "cameraState": {
            "perspective": True,
            "distance": 25.0,
            "phi": 0.0,
            "thetaOffset": 0.0,
            "targetOffset": [0.0, 0.0, 0.0],
            "target": [0.0, 0.0, 0.0],
            "targetOrientation": [0.0, 0.0, 0.0, 1.0],
            "fovy": 45.0,
            "near": 0.1,
            "far": 5000.0,
        },
        "followMode": "follow-none",
        "followTf": frame or (f"{tracks[0]}/slam" if tracks else None),
        "scene": {"transforms": {"labelSize": 0.1, "axisScale": 0.5}},
        "transforms": {},
        "topics": topics,
        "layers": {
            "grid": {"layerId": "foxglove.Grid", "instanceId": "grid", "visible": True, "size": 20, "divisions": 20}
        },
    }


def _residuals() -> list[dict[str, Any]]:
    return [
        _path(f'/ranges{{verdict=="{verdict}"}}.residual', verdict, show_line=False) for verdict in ("used", "rejected")
    ]


def _lines(names: Sequence[str], what: str) -> list[dict[str, Any]]:
    return [_path(f"{_topic('/states/', name)}.{what}", name, show_line=True) for name in names]


def _path(value: str, label: str, show_line: bool) -> dict[str, Any]:
    return {
        "value": value,
        "label": label,
        "enabled": True,
        "showLine": show_line,
        "timestampMethod": "receiveTime",
    }


def _plot(title: str, paths: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "title": title,
        "paths": paths,
        "showLegend": True,
        "legendDisplay": "floating",
        "isSynced": True,
        "xAxisVal": "timestamp",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
    }


def _topic(folder: str, name: str) -> str:
    """A topic in a message path: in quotation marks where the name is not of letters, numbers and underscores."""
    topic = folder + name
    return topic if name.replace("_", "").isalnum() and name.isascii() else json.dumps(topic, ensure_ascii=False)
