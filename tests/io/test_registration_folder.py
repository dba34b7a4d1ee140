from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Alternative, RangeVerdicts, Registration, State, UserRegistration
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame
from synchronizar.io.registration_folder import registration_json, write_registration
from synchronizar.io.tum import read_tum
from synchronizar.reporting.tables import registration_table

WALK = Track(
    np.array([10.0, 10.5, 11.0]),
    np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 2.0, 0.0]]),
    np.array([[0.0, 0.0, 0.0, 1.0]] * 3),
)
BEACON_COVARIANCE = np.full((4, 4), np.nan)
BEACON_COVARIANCE[:3, :3] = np.diag([0.01, 0.04, 0.09])


@pytest.fixture
def recording() -> Recording:
    names = ("alice", "beacon", "bob", "carol", "dave")
    a, b = np.array([0, 0, 2, 2, 0, 0], dtype=np.int32), np.array([2, 2, 0, 0, 1, 4], dtype=np.int32)
    return Recording(
        tuple(User(name, static=name == "beacon") for name in names),
        {name: WALK for name in names if name != "beacon"},
        Ranges.of(np.array([1.0, 1.5, 2.0, 2.5, 3.0, 4.0]), a, b, np.array([3.0, 0.1, 9.0, -6e6, 2.0, 1.0])),
    )


@pytest.fixture
def registration() -> Registration:
    users = (
        UserRegistration("alice", State.REGISTERED, "reference", YawFrame(), np.zeros((4, 4))),
        UserRegistration(
            "beacon",
            State.AMBIGUOUS,
            "a mirror image fits too",
            YawFrame(1.0, 2.0, 3.0),
            BEACON_COVARIANCE,
            static=True,
        ),
        UserRegistration(
            "bob",
            State.REGISTERED,
            "seen from all sides",
            YawFrame(4.0, -5.0, 0.5, np.pi / 2.0),
            np.diag([9, 4, 1, 0.25]),
        ),
        UserRegistration(
            "carol",
            State.UNOBSERVABLE,
            "stood still",
            YawFrame(1.0, 1.0, 1.0, 1.0),
            np.diag([1.0, 1.0, 1.0, np.inf]),
            unseen_direction=np.array([0.0, 0.0, np.nan, 1.0]),
            prior_dominated=("z", "yaw"),
        ),
        UserRegistration("dave", State.DISCONNECTED, "no ranges", None, None),
    )
    return Registration(
        reference="alice",
        model="rigid",
        method="joint",
        users={user.name: user for user in users},
        alternatives=tuple(
            Alternative(cost, {"beacon": YawFrame(1.0, 2.0, z), "bob": YawFrame(4.0, -5.0, 0.5, np.pi / 2.0)})
            for cost, z in ((0.0, 3.0), (0.25, -3.0))
        ),
        ranges=RangeVerdicts(
            usable=np.array([True, True, True, False, True, False]),
            used=np.array([True, True, False, False, True, False]),
            weight=np.array([100.0, 50.0, 0.25, 0.0, 100.0, 0.0]),
            residual=np.array([1.0 / 3.0, -0.1, 6.0, np.nan, 0.0, np.nan]),
        ),
        seconds={"load": 0.5, "initialise": 0.25, "solve": 1.0},
    )


def place(x: float | None, y: float | None, z: float | None, yaw: float | None) -> dict[str, float | None]:
    return {"x": x, "y": y, "z": z, "yaw": yaw}


def test_the_contract_is_kept(registration: Registration) -> None:
    exact = {"scale": 1.0, "range_bias": 0.0, "clock_offset": 0.0, "sigma": None, "slam_noise": None, "jumps": []}
    assert json.loads(json.dumps(registration_json(registration), allow_nan=False)) == {
        "reference": "alice",
        "model": "rigid",
        "method": "joint",
        "users": {
            "alice": {
                "state": "registered",
                "reason": "reference",
                **place(0.0, 0.0, 0.0, 0.0),
                "matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
                "covariance": [[0.0] * 4] * 4,
                **exact,
                "prior_dominated": [],
            },
            "beacon": {
                "state": "ambiguous",
                "reason": "a mirror image fits too",
                **place(1.0, 2.0, 3.0, None),
                "matrix": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
                "covariance": [[0.01, 0, 0, None], [0, 0.04, 0, None], [0, 0, 0.09, None], [None] * 4],
                **exact,
                "prior_dominated": [],
            },
            "bob": {
                "state": "registered",
                "reason": "seen from all sides",
                **place(4.0, -5.0, 0.5, np.pi / 2.0),
                "matrix": pytest.approx(np.array([[0, -1, 0, 4], [1, 0, 0, -5], [0, 0, 1, 0.5], [0, 0, 0, 1]])),
                "covariance": [[9, 0, 0, 0], [0, 4, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0.25]],
                **exact,
                "prior_dominated": [],
            },
            "carol": {
                "state": "unobservable",
                "reason": "stood still",
                **place(1.0, 1.0, 1.0, 1.0),
                "matrix": pytest.approx(
                    np.array(
                        [
                            [np.cos(1.0), -np.sin(1.0), 0, 1],
                            [np.sin(1.0), np.cos(1.0), 0, 1],
                            [0, 0, 1, 1],
                            [0, 0, 0, 1],
                        ]
                    )
                ),
                "covariance": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, None]],
                **exact,
                "prior_dominated": ["z", "yaw"],
                "unseen_direction": {"x": 0.0, "y": 0.0, "z": None, "yaw": 1.0},
            },
            "dave": {
                "state": "disconnected",
                "reason": "no ranges",
                **place(None, None, None, None),
                "matrix": None,
                "covariance": None,
                **exact,
                "prior_dominated": [],
            },
        },
        "alternatives": [
            {
                "cost": cost,
                "users": {
                    "beacon": place(1.0, 2.0, z, None),
                    "bob": place(4.0, -5.0, 0.5, np.pi / 2.0),
                },
            }
            for cost, z in ((0.0, 3.0), (0.25, -3.0))
        ],
        "ranges": {"used": 3, "rejected": 1, "unusable": 2},
        "findings": [],
        "seconds": {"load": 0.5, "initialise": 0.25, "solve": 1.0},
    }


def test_an_unseen_direction_is_told_of_unobservable_users_alone(registration: Registration) -> None:
    bob = replace(registration.users["bob"], unseen_direction=np.array([0.0, 0.0, 1.0, 0.0]))
    out = registration_json(replace(registration, users={"bob": bob}))
    assert "unseen_direction" not in out["users"]["bob"]


def test_tracks_are_written_in_the_common_frame_at_their_own_stamps(
    registration: Registration, recording: Recording, tmp_path: Path
) -> None:
    write_registration(registration, recording, tmp_path / "out")
    bob = read_tum(tmp_path / "out/bob.tum")
    np.testing.assert_array_equal(bob.t, WALK.t)
    np.testing.assert_allclose(bob.position, [[4.0, -5.0, 0.5], [4.0, -4.0, 0.5], [2.0, -4.0, 0.5]], atol=1e-8)
    np.testing.assert_allclose(np.abs(bob.quat_xyzw), [[0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]] * 3, atol=1e-8)
    np.testing.assert_allclose(np.loadtxt(tmp_path / "out/beacon.tum"), [0, 1, 2, 3, 0, 0, 0, 1])
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == [
        "alice.tum",
        "beacon.tum",
        "bob.tum",
        "carol.tum",
        "ranges.csv",
        "registration.json",
    ]
    written = json.loads((tmp_path / "out/registration.json").read_text())
    assert written == registration_json(registration)


def test_each_range_is_written_with_what_became_of_it(
    registration: Registration, recording: Recording, tmp_path: Path
) -> None:
    write_registration(registration, recording, tmp_path)
    assert (tmp_path / "ranges.csv").read_text().splitlines() == [
        "t,a,b,range,residual,weight,verdict",
        "1.0,alice,bob,3.0,0.3333333333333333,100.0,used",
        "1.5,alice,bob,0.1,-0.1,50.0,used",
        "2.0,bob,alice,9.0,6.0,0.25,rejected",
        "2.5,bob,alice,-6000000.0,,0.0,unusable",
        "3.0,alice,beacon,2.0,0.0,100.0,used",
        "4.0,alice,dave,1.0,,0.0,unusable",
    ]


def test_an_earlier_track_of_a_user_that_is_now_disconnected_goes(
    registration: Registration, recording: Recording, tmp_path: Path
) -> None:
    (tmp_path / "dave.tum").write_text("0 0 0 0 0 0 0 1\n")
    (tmp_path / "notes.txt").write_text("mine")
    write_registration(registration, recording, tmp_path)
    assert not (tmp_path / "dave.tum").exists()
    assert (tmp_path / "notes.txt").exists()


@pytest.mark.parametrize("in_the_way", ["alice.tum", "dave.tum", "ranges.csv", "registration.json"])
def test_what_cannot_be_written_is_told(
    registration: Registration, recording: Recording, tmp_path: Path, in_the_way: str
) -> None:
    (tmp_path / in_the_way).mkdir()
    with pytest.raises(InputError, match=rf"{in_the_way}: Is a directory$"):
        write_registration(registration, recording, tmp_path)


def test_tracks_of_an_earlier_answer_are_removed(
    registration: Registration, recording: Recording, tmp_path: Path
) -> None:
    write_registration(registration, recording, tmp_path)
    (tmp_path / "zoe.tum").write_text("0 0 0 0 0 0 0 1\n")
    (tmp_path / "notes.txt").write_text("mine")
    write_registration(registration, recording, tmp_path)
    assert not (tmp_path / "zoe.tum").exists()
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_tracks_in_a_folder_that_is_no_answer_are_left_alone(
    registration: Registration, recording: Recording, tmp_path: Path
) -> None:
    (tmp_path / "zoe.tum").write_text("0 0 0 0 0 0 0 1\n")
    write_registration(registration, recording, tmp_path)
    assert (tmp_path / "zoe.tum").exists()


def test_a_folder_that_cannot_be_made_is_told(registration: Registration, recording: Recording, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(InputError, match=r"out: File exists$"):
        write_registration(registration, recording, tmp_path / "out")


def test_the_table_has_a_row_a_user_and_the_counts_below(registration: Registration) -> None:
    head, alice, beacon, bob, carol, dave, counts = registration_table(registration).splitlines()
    units = ["x (m)", "y (m)", "z (m)", "yaw (°)", "± xy (m)", "± z (m)", "± yaw (°)"]
    assert head.split() == " ".join(["user", "state", *units]).split()
    assert alice.split()[:2] == ["alice", "registered"]
    assert alice.endswith("the reference: its own frame at its last pose, in that at its first")
    assert beacon.split(maxsplit=9)[2:] == [
        "+1.00",
        "+2.00",
        "+3.00",
        "-",
        "0.20",
        "0.30",
        "-",
        "a mirror image fits too",
    ]
    assert bob.split()[2:9] == ["+4.00", "-5.00", "+0.50", "+90.0", "3.00", "1.00", "28.6"]
    assert carol.split()[8] == "-"
    assert dave.split()[:9] == ["dave", "disconnected", *["-"] * 7]
    assert counts == "ranges: 3 used, 1 rejected, 2 unusable; 1.75 s"
    assert len({row.index(row.split()[1]) for row in (alice, beacon, bob, carol, dave)}) == 1


def test_the_sigma_in_the_plane_is_that_of_the_longest_axis(registration: Registration) -> None:
    # An ellipse of 5 m by 1 m, turned by 30 degrees.
    c, s = np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)
    covariance = np.eye(4)
    covariance[:2, :2] = np.array([[c, -s], [s, c]]) @ np.diag([25.0, 1.0]) @ np.array([[c, s], [-s, c]])
    bob = replace(registration.users["bob"], covariance=covariance)
    row = registration_table(replace(registration, users={"bob": bob})).splitlines()[1]
    assert row.split()[6] == "5.00"
