"""Two robots and a radio on the wall, from arrays: no files.

`python examples/from_arrays.py`
"""

import numpy as np

import synchronizar as sz

SECONDS, RATE_HZ = 15.0, 10.0
WALL = np.array([4.0, 3.0, 2.2])  # m, in the frame of the first robot


def main() -> None:
    """Register robots that drive through each other's neighbourhood."""
    t = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    first = np.column_stack([2.5 * np.sin(0.5 * t), 2.0 * np.sin(0.8 * t), 0.3 + 0.1 * np.sin(0.9 * t)])
    second = np.column_stack([3.0 * np.cos(0.4 * t), 2.0 * np.sin(0.6 * t), 0.3 + 0.1 * np.cos(0.7 * t)])
    second_own, yaw = own_frame(second, first_from_own=(1.0, -2.0, 0.05, 0.7))

    noise = np.random.default_rng(1)
    recording = sz.Recording.from_arrays(
        tracks={"first": (t, first, facing(len(t), 0.0)), "second": (t, second_own, facing(len(t), -yaw))},
        ranges=[
            *ranges(t, "first", "second", first - second, noise),
            *ranges(t, "first", "wall", first - WALL, noise),
            *ranges(t, "second", "wall", second - WALL, noise),
        ],
        users={"wall": {"static": True}},
    )
    registration = sz.register(recording)

    for name, user in registration.users.items():
        print(f"{name}: {user.state}: {user.reason}")
    found = registration.between("first", "second") @ second_own
    print(f"error: {np.linalg.norm(found - second, axis=1).max():.3f} m")


def own_frame(points: np.ndarray, first_from_own: tuple[float, float, float, float]) -> tuple[np.ndarray, float]:
    """The same points (n, 3) in a frame that lies at x, y, z (m), yaw (rad) in theirs; and that yaw."""
    x, y, z, yaw = first_from_own
    c, s = np.cos(yaw), np.sin(yaw)
    return (points - [x, y, z]) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), yaw


def facing(n: int, yaw: float) -> np.ndarray:
    """(n, 4) attitudes x y z w of a device that is turned by yaw (rad) about the vertical all the while."""
    return np.tile([0.0, 0.0, np.sin(yaw / 2.0), np.cos(yaw / 2.0)], (n, 1))


def ranges(
    t: np.ndarray, a: str, b: str, between: np.ndarray, noise: np.random.Generator
) -> list[tuple[float, str, str, float]]:
    """Distances with noise of 0.1 m (1 sigma), from the vectors (n, 3) between two devices."""
    distances = np.linalg.norm(between, axis=1) + noise.normal(0.0, 0.1, len(t))
    return [(when, a, b, distance) for when, distance in zip(t.tolist(), distances.tolist(), strict=True)]


if __name__ == "__main__":
    main()
