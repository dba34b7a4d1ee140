"""Two iPhones: ARKit's camera transforms and Nearby Interaction's distances in, a cube of Alice's at Bob's out.

ARKit's frames are y up and its `transform` is a 4 x 4 matrix from camera axes to the session's frame. Everything below
stays in these axes.

`python examples/two_phones_arkit.py`
"""

import gtsam
import numpy as np

import synchronizar as sz

ANTENNA = [0.03, 0.05, 0.0]  # m, from the camera, in its axes
BOB_FROM_ALICE = np.array([[0.0, 0.0, -1.0, 1.0], [0.0, 1.0, 0.0, 0.1], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 0.0, 1.0]])


def main() -> None:
    """Alice puts a cube 1 m ahead of where she began; print where Bob has to draw it."""
    t = np.arange(0.0, 15.0, 0.1)
    alice = camera_transforms(t, 2.0 * np.sin(0.5 * t), -2.0 * np.sin(0.8 * t))
    bob_in_alice = camera_transforms(t + 5.0, 3.0 * np.cos(0.4 * t), -2.0 * np.sin(0.6 * t))
    bob = BOB_FROM_ALICE @ bob_in_alice
    settings = {"antennas": {"uwb": ANTENNA}}
    recording = sz.Recording.from_arrays(
        tracks={"alice": track(t, alice), "bob": track(t, bob)},
        ranges=[(when, "alice", "bob", distance) for when, distance in nearby(t, alice, bob_in_alice)],
        up="y",
        users={"alice": settings, "bob": settings},
    )
    registration = sz.register(recording)
    print(f"bob: {registration.users['bob'].state}: {registration.users['bob'].reason}")

    cube = np.array([0.0, 0.0, -1.0])  # in Alice's session: 1 m ahead, for -z is ahead
    found = registration.between("bob", "alice") @ cube
    true = BOB_FROM_ALICE[:3, :3] @ cube + BOB_FROM_ALICE[:3, 3]
    print(f"Bob draws the cube at {np.round(found, 2)} of his own session; it is at {np.round(true, 2)}")
    print(f"error: {np.linalg.norm(found - true):.3f} m")


def track(t: np.ndarray, transforms: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """ARKit's transforms (n, 4, 4) as stamps (n,), positions (n, 3) and quaternions (n, 4) x y z w."""
    quats = [gtsam.Rot3(transform[:3, :3]).toQuaternion() for transform in transforms]
    return t, transforms[:, :3, 3], np.array([[q.x(), q.y(), q.z(), q.w()] for q in quats])


def camera_transforms(t: np.ndarray, x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(n, 4, 4): a phone that is carried along x, z (m) and looks about; y is up, and bobs."""
    transforms = np.tile(np.eye(4), (len(t), 1, 1))
    for n, when in enumerate(t):
        look = gtsam.Rot3.Ry(0.6 * np.sin(0.7 * when)) * gtsam.Rot3.Rx(0.2 * np.sin(1.1 * when))
        transforms[n, :3, :3] = look.matrix()
        transforms[n, :3, 3] = x[n], 0.05 * np.sin(9.0 * when), z[n]
    return transforms


def nearby(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> list[tuple[float, float | None]]:
    """Distances (m) between the phones' antennas with noise of 0.1 m; now and then a phone has none."""
    noise = np.random.default_rng(4)
    at = [transforms[:, :3, :3] @ ANTENNA + transforms[:, :3, 3] for transforms in (a, b)]
    distances = np.linalg.norm(at[0] - at[1], axis=1) + noise.normal(0.0, 0.1, len(t))
    return [
        (when, None if noise.random() < 0.05 else distance)
        for when, distance in zip(t.tolist(), distances.tolist(), strict=True)
    ]


if __name__ == "__main__":
    main()
