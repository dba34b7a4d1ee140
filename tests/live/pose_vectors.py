"""Makes `vectors/poses.json`: bytes of poses, as Python writes them, for clients in other languages.

PYTHONPATH=.:tests .venv/bin/python -m live.pose_vectors
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from synchronizar.live.pose_wire import PoseDown, PosesDown, PoseUp, encode_poses_down, encode_poses_up

VECTORS = Path(__file__).parent / "vectors" / "poses.json"


def vectors() -> dict[str, Any]:
    """Poses, and their bytes in hex."""
    up = [
        PoseUp(0, 0, 0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        PoseUp(3, 255, 4294967295, 1764367380.123456, (-12.25, 3.5e4, 0.001), (0.5, -0.5, 0.5, -0.5)),
    ]
    down = [
        PosesDown(0, 12.5, []),
        PosesDown(
            77,
            1764367380.25,
            [
                PoseDown(0, "registered", 0, 0.0, (1.0, -2.0, 3.0), (0.0, 0.0, 0.0, 1.0)),
                PoseDown(40, "disconnected", 200, 0.25, (-0.125, 1e-3, 7e3), (0.5, 0.5, -0.5, 0.5)),
            ],
        ),
    ]
    return {
        "up": [{"pose": pose._asdict(), "hex": encode_poses_up([pose]).hex()} for pose in up],
        "down": [
            {
                "poses": {**poses._asdict(), "poses": [pose._asdict() for pose in poses.poses]},
                "hex": encode_poses_down(poses).hex(),
            }
            for poses in down
        ],
    }


def main() -> None:
    """Write the file."""
    VECTORS.write_text(json.dumps(vectors(), indent=1) + "\n")


if __name__ == "__main__":
    main()
