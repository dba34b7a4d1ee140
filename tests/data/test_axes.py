"""Points and transforms are in the axes of each user's own track, y up where that is y up."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import synchronizar as sz
from synchronizar.arrays import Array
from synchronizar.geometry import YawFrame
from synchronizar.io.registration_folder import write_registration
from synchronizar.io.tum import read_tum
from synchronizar.reporting.evaluate import evaluate_folder

# By hand, as ARKit has it: x right, y up, z backwards. A room with z up and x forwards has x = -z, y = -x, z = y.
ROOM_FROM_ARKIT = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def turn_about_up(yaw: float) -> Array:
    """(3, 3) in ARKit's axes: a turn to the left about y, written out."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def turn_about_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def quaternion(rotation: Array) -> Array:
    """(4,) x y z w of a rotation (3, 3) whose w is not small."""
    w = 0.5 * np.sqrt(1.0 + np.trace(rotation))
    away = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return np.append(away / (4.0 * w), w)


LEVER = np.array([0.03, 0.07, -0.02])  # of the radio in the phone, in the phone's own axes
# Bob's world in Alice's, both ARKit's: turned to the left by 0.8 rad, its origin 2 m to the right, 3 m ahead, 0.1 m up.
ALICE_FROM_BOB = turn_about_up(0.8), np.array([2.0, 0.1, -3.0])


def phones() -> dict[str, tuple[Array, Array, Array]]:
    """Two phones that walk upright and pitched, each in its own ARKit world."""
    t = np.arange(0.0, 30.0, 1.0 / 30.0)
    walks = {}
    for name, phase, pitch in (("alice", 0.0, -0.3), ("bob", 1.7, -0.5)):
        right = 2.0 * np.sin(0.5 * t + phase) + 0.7 * np.sin(1.1 * t)
        ahead = 1.5 * np.cos(0.37 * t + phase) + 0.5 * np.sin(0.9 * t + phase)
        up = 0.15 * np.sin(0.7 * t + phase)
        heading = 0.8 * np.sin(0.3 * t + phase)
        position = np.column_stack([right, up, -ahead])
        quats = np.array([quaternion(turn_about_up(h) @ turn_about_x(pitch)) for h in heading])
        walks[name] = t, position, quats
    rotation, origin = ALICE_FROM_BOB
    t, position, quats = walks["bob"]
    inside = (position - origin) @ rotation  # bob walks where he does in Alice's world; told in his own
    own = np.array([quaternion(rotation.T @ turn_about_up(h)) for h in np.zeros(1)])[0]
    walks["bob"] = t, inside, np.array([hamilton(own, q) for q in quats])
    return walks


def hamilton(p: Array, q: Array) -> Array:
    x1, y1, z1, w1 = p
    x2, y2, z2, w2 = q
    return np.array(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ]
    )


def rotated(q: Array, v: Array) -> Array:
    """v turned by q, by the definition q v q*."""
    return hamilton(hamilton(q, np.append(v, 0.0)), q * np.array([-1.0, -1.0, -1.0, 1.0]))[:3]


def recording() -> sz.Recording:
    walks = phones()
    rotation, origin = ALICE_FROM_BOB
    t, alice, alice_quats = walks["alice"]
    _, bob, bob_quats = walks["bob"]
    rows = np.arange(0, len(t), 3)
    random = np.random.default_rng(0)
    ranges = []
    for k in rows.tolist():
        antenna_alice = alice[k] + rotated(alice_quats[k], LEVER)
        antenna_bob = rotation @ (bob[k] + rotated(bob_quats[k], LEVER)) + origin
        distance = float(np.linalg.norm(antenna_alice - antenna_bob)) + 0.02 * random.standard_normal()
        ranges.append((t[k], "alice", "bob", distance))
    antennas = {"antennas": {"0": LEVER.tolist()}}
    return sz.Recording.from_arrays(walks, ranges, up="y", users={"alice": antennas, "bob": antennas})


@pytest.fixture(scope="module")
def registration() -> sz.Registration:
    return sz.register(recording())


def test_two_arkit_phones_find_each_other_in_their_own_axes(registration: sz.Registration) -> None:
    rotation, origin = ALICE_FROM_BOB
    points = phones()["bob"][1][::50]
    found = registration.between("alice", "bob") @ points
    np.testing.assert_allclose(found, points @ rotation.T + origin, atol=0.1)
    np.testing.assert_allclose(registration.between("bob", "alice") @ found, points, atol=1e-9)


def test_common_from_user_takes_y_up_points_to_the_z_up_common_frame(registration: sz.Registration) -> None:
    # The common frame has the origin and the heading of Alice's world at her first pose.
    alice, bob = (registration.users[name].common_from_user for name in ("alice", "bob"))
    assert alice is not None
    assert bob is not None
    one_up = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(np.diff(alice @ one_up, axis=0), [[0.0, 0.0, -alice.scale]], atol=1e-9)
    np.testing.assert_allclose(np.diff(bob @ one_up, axis=0), [[0.0, 0.0, -bob.scale]], atol=1e-9)
    rotation, origin = ALICE_FROM_BOB
    points = phones()["bob"][1][::50]
    np.testing.assert_allclose(bob @ points, (points @ rotation.T + origin) @ ROOM_FROM_ARKIT.T, atol=0.1)


def test_the_matrix_is_the_same_map(registration: sz.Registration, tmp_path: Path) -> None:
    bob = registration.users["bob"].common_from_user
    assert bob is not None
    point = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose((bob.matrix @ np.append(point, 1.0))[:3], bob @ point, atol=1e-12)
    write_registration(registration, recording(), tmp_path)
    said = json.loads((tmp_path / "registration.json").read_text())["users"]["bob"]
    np.testing.assert_allclose(said["matrix"], bob.matrix, atol=1e-15)
    # x, y, z, yaw are those of the track read z up.
    c, s = np.cos(said["yaw"]), np.sin(said["yaw"])
    z_up = said["scale"] * np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ ROOM_FROM_ARKIT @ point
    origin = np.array([said["x"], said["y"], said["z"]])
    np.testing.assert_allclose(z_up + origin, bob @ point, atol=1e-9)


def test_written_tracks_are_in_the_z_up_common_frame(registration: sz.Registration, tmp_path: Path) -> None:
    write_registration(registration, recording(), tmp_path)
    bob = registration.users["bob"].common_from_user
    assert bob is not None
    own = phones()["bob"][1]
    np.testing.assert_allclose(read_tum(tmp_path / "bob.tum").position[-1], bob @ own[-1], atol=1e-6)


@pytest.mark.parametrize("up", ["y", "z"])
def test_truth_has_the_axes_of_its_user(registration: sz.Registration, tmp_path: Path, up: str) -> None:
    rotation, origin = ALICE_FROM_BOB
    walks = phones()
    walk, answer = tmp_path / "walk", tmp_path / "answer"
    recording().save(walk)
    write_registration(registration, recording(), answer)
    (walk / "truth").mkdir()
    world = {"alice": walks["alice"][1], "bob": walks["bob"][1] @ rotation.T + origin}
    if up == "z":
        (walk / "recording.toml").write_text('up = "z"')
        world = {name: places @ ROOM_FROM_ARKIT.T for name, places in world.items()}
    for name, places in world.items():
        rows = np.column_stack([walks[name][0], places, np.tile([0.0, 0.0, 0.0, 1.0], (len(places), 1))])
        np.savetxt(walk / "truth" / f"{name}.tum", rows)
    evaluation = evaluate_folder(walk, answer)
    assert evaluation.joint_ate is not None
    assert evaluation.joint_ate < 0.1


def test_a_recording_keeps_its_axes_when_it_is_saved(tmp_path: Path) -> None:
    recording().save(tmp_path)
    assert 'up = "y"' in (tmp_path / "recording.toml").read_text()
    saved = np.loadtxt(tmp_path / "tracks" / "bob.tum")
    np.testing.assert_allclose(saved[:, 1:4], phones()["bob"][1], atol=1e-8)


def test_frames_that_disagree_on_up_are_not_composed() -> None:
    with pytest.raises(ValueError, match="y up in the one and z up in the other"):
        YawFrame(up_b="y") @ YawFrame()
