"""Frames while people walk: poses and ranges go in as they come, and the answer can be read at any moment.

`python examples/streaming.py`
"""

import numpy as np

import synchronizar as sz

POSES_HZ, RANGES_HZ, SECONDS = 30.0, 10.0, 20.0
UPRIGHT = [0.0, 0.0, 0.0, 1.0]


def main() -> None:
    """Walk, and print what happens."""
    noise = np.random.default_rng(3)
    # This walk is made up faster than anybody walks: no search would keep up with it in a process of its own.
    estimator = sz.Estimator(["alice", "bob"], reference="alice", workers=0)
    for n in range(int(SECONDS * POSES_HZ)):
        t = n / POSES_HZ
        estimator.add_pose("alice", t, alice(t), UPRIGHT)
        estimator.add_pose("bob", t, bob_in_his_own_frame(t), UPRIGHT)
        if n % int(POSES_HZ / RANGES_HZ):
            continue
        estimator.add_range(t, "alice", "bob", np.linalg.norm(alice(t) - bob(t)) + noise.normal(0.0, 0.1))
        for event in estimator.advance(t):
            print(f"{t:5.1f} s  {event}")
        if t == int(t) and t <= 10.0:
            user = estimator.registration().users["bob"]
            print(f"{t:5.1f} s  bob: {user.state}, progress {user.progress:.0%}, {user.cue or 'no cue'}")

    user = estimator.registration().users["bob"]
    found = user.common_from_user @ bob_in_his_own_frame(t)
    print(f"bob: {user.state}")
    print(f"error: {np.linalg.norm(found - bob(t)):.3f} m")


def alice(t: float) -> np.ndarray:
    """(3,) m: where Alice is, in her own frame."""
    return np.array([2.0 * np.sin(0.5 * t), 2.0 * np.sin(0.8 * t), 0.05 * np.sin(9.0 * t)])


def bob(t: float) -> np.ndarray:
    """(3,) m: where Bob is, in Alice's frame."""
    return np.array([3.0 * np.cos(0.4 * t), 2.0 * np.sin(0.6 * t), 0.05 * np.cos(8.0 * t)])


def bob_in_his_own_frame(t: float) -> np.ndarray:
    """(3,) m: the same in Bob's frame, which began 3 m away and is turned by 90 degrees."""
    x, y, z = bob(t) - [3.0, 0.0, 0.0]
    return np.array([y, -x, z])


if __name__ == "__main__":
    main()
