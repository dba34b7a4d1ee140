"""Makes `vectors/smoothing.json`, which the rule in Python and the one in JavaScript are both held to.

    PYTHONPATH=.:tests .venv/bin/python -m live.smoothing_vectors

Each case is a list of calls with what they return.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from synchronizar.live.smoothing import InView, Placing, Smoother

VECTORS = Path(__file__).parent / "vectors" / "smoothing.json"
Call = dict[str, Any]


def covariance(sigma: float, sigma_yaw: float) -> list[list[float]]:
    # What is known of the yaw is known about a place 4 m off, so that x, y and yaw are correlated.
    root = np.diag([sigma, 0.6 * sigma, sigma, sigma_yaw])
    root[0, 3], root[1, 3] = 3.0 * sigma_yaw, -4.0 * sigma_yaw
    return [[round(v, 9) for v in row] for row in (root @ root.T).tolist()]


def scripts() -> dict[str, list[Call]]:
    """What is called in each case."""
    rng = np.random.default_rng(7)
    sure, unsure = covariance(0.004, 0.001), covariance(0.08, 0.02)

    def solved(t: float, x: float, y: float, z: float, yaw: float, scale: float, cov: Any, at: list[float]) -> Call:
        placing = {"x": x, "y": y, "z": z, "yaw": yaw, "scale": scale}
        return {"call": "solved", "t": t, "placing": placing, "covariance": cov, "at": at}

    def steps(n: int, dt: float, at: list[float], in_view: InView = "things") -> list[Call]:
        return [{"call": "step", "dt": dt, "at": at, "in_view": in_view} for _ in range(n)]

    near, far = [1.0, -2.0, 0.3], [40.0, 25.0, 1.0]
    noisy: list[Call] = []
    for k in range(12):
        offset = (0.02 * rng.standard_normal(5)).round(6).tolist()
        at = [k * 0.1, 1.0, 0.0]
        scale = round(1.0 + 0.1 * offset[4], 6)
        noisy += [solved(0.5 * k, offset[0], offset[1], offset[2], offset[3], scale, unsure, at), *steps(5, 0.1, at)]
    return {
        "nothing solved": steps(1, 0.02, near),
        "a small correction": [
            *[solved(0.0, 1.0, 2.0, 0.0, 0.7, 1.0, sure, near), *steps(20, 0.02, near)],
            *[solved(0.5, 1.04, 1.98, 0.01, 0.71, 1.001, sure, near), *steps(30, 0.02, near)],
        ],
        "people alone": [
            *[solved(0.0, 1.0, 2.0, 0.0, 0.7, 1.0, sure, near), *steps(20, 0.02, near, "people")],
            *[solved(0.5, 1.2, 1.9, 0.01, 0.72, 1.001, sure, near), *steps(30, 0.02, near, "people")],
            *[solved(1.5, 2.2, 1.9, 0.01, 0.72, 1.001, sure, near), *steps(30, 0.02, near, "people")],
        ],
        "within the noise": noisy,
        "far from its origin": [
            *[solved(0.0, -3.0, 9.0, 0.0, 3.1, 1.0, sure, far), *steps(16, 0.02, far)],
            *[solved(0.5, -3.0, 9.0, 0.0, 3.101, 1.0, sure, far), *steps(20, 0.033, far)],
            *[solved(1.0, -3.1, 9.2, 0.0, -3.1816, 1.0, sure, far), *steps(20, 0.033, far)],
        ],
        "a jump": [
            *[solved(0.0, 0.0, 0.0, 0.0, 0.0, 1.0, sure, near), *steps(10, 0.05, near)],
            *[solved(0.5, 3.0, 1.0, 0.1, 0.5, 1.0, sure, near), *steps(16, 0.05, near)],
            *[solved(1.5, 0.0, 0.0, 0.0, 0.0, 1.0, sure, near), *steps(3, 0.05, near, "nothing")],
            *[{"call": "lost"}, solved(3.0, 0.3, 0.1, 0.1, 0.05, 1.0, sure, near), *steps(10, 0.05, near, "nothing")],
            *[{"call": "forget"}, *steps(1, 0.05, near)],
            *[solved(4.0, 5.0, 5.0, 0.0, 2.0, 1.02, sure, near), *steps(8, 0.05, near)],
        ],
        "creeping": [
            call
            for k in range(30)
            for call in (solved(float(k), 0.02 * k, 0.0, 0.0, 0.0, 1.0, sure, near), *steps(2, 0.5, near))
        ],
    }


def run(script: list[Call]) -> list[Call]:
    """The calls with what they return."""
    smoother, out = Smoother(), []
    for call in script:
        returned: Any = None
        match call["call"]:
            case "solved":
                alarm = smoother.solved(call["t"], Placing(**call["placing"]), call["covariance"], call["at"])
                returned = None if alarm is None else alarm._asdict()
            case "step":
                shown = smoother.step(call["dt"], call["at"], call["in_view"])
                returned = None if shown is None else {**shown.placing._asdict(), "opacity": shown.opacity}
            case "lost":
                smoother.lost()
            case "forget":
                smoother.forget()
        out.append({**call, "returns": returned})
    return out


def main() -> None:
    """Write the file."""
    cases = {name: run(script) for name, script in scripts().items()}
    lines = ",\n".join(
        f'"{name}": [\n' + ",\n".join(json.dumps(call) for call in calls) + "\n]" for name, calls in cases.items()
    )
    VECTORS.write_text("{\n" + lines + "\n}\n")


if __name__ == "__main__":
    main()
