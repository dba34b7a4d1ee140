"""A robot that mirrors one of three people who walk about, with a fake clock: how near it comes, how far it is off.

`python -m experiments.apps.robot_among_people [--runs 100] [--seconds 60]`: words of the room come 30 times a second,
60 ms late; 30 % of them are lost, and all of them for up to 1.5 s now and then; the robot's frame is off by 0.1 m and
0.03 rad, as told, and is sometimes not registered for some seconds; one command in ten is lost. People stand still and
turn elsewhere where the robot is in their way within a metre: they walk past it, but not through it. Told is the
nearest that anybody and the robot came (m), and the error of the mirror image in place (m) and heading (degrees),
median over a run: always, and while the robot may be where the image is, `FREE_M` from everybody. Also how long it
takes until it is told to stop once the room says that it is not registered, and until it stands (s, largest of a run).
"""

from __future__ import annotations

import argparse
from math import atan2, cos, degrees, hypot, pi, sin
from typing import NamedTuple

import numpy as np

from experiments.common.results import FOLDER, write_table
from experiments.common.study import figure
from synchronizar.apps.bodies.drive import STOP, Drive, Ground
from synchronizar.apps.robot.mirror import mirror_between
from synchronizar.apps.robot.pilot import Pilot
from synchronizar.arrays import Array
from synchronizar.geometry import wrap_angle

STEP_S = 1.0 / 60.0
LATE_S = 0.06
PEOPLE = 3
PACE, ROOM_M = 0.8, 6.0
"""m/s and m."""
OFF_M, OFF_RAD, PERSON_SIGMA = 0.1, 0.03, 0.08
BEGINS_S, JUDGED_FROM_S = 1.0, 5.0
FREE_M = 1.5
"""m: an image so far from everybody is where the robot may be, by what it knows of places."""
NEVER_NEARER_M, STOPS_WITHIN_S = 0.5, 0.3


class Walked(NamedTuple):
    """One run."""

    nearest: float
    mirror_error: float
    heading_error: float
    """rad."""
    free_error: float
    free_heading_error: float
    """rad; both while the image is free."""
    told_after: float
    stands_after: float
    """s, the longest; NaN where it did not lose its place while it moved."""


class Walker:
    """Somebody who walks from one random place to the next, and not into the robot."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random
        self.place: Array = random.uniform(-0.3 * ROOM_M, 0.0, 2)
        self.heading = self.speed = 0.0
        self._goal = self.place.copy()

    def step(self, robot: Ground) -> None:
        """Go on."""
        if np.hypot(*(self._goal - self.place)) < 0.2:
            self._goal = self._random.uniform(-0.5 * ROOM_M, 0.5 * ROOM_M, 2)
        to_robot = np.array([robot.x, robot.y]) - self.place
        in_the_way = np.hypot(*to_robot) < 1.0 and float(to_robot @ [cos(self.heading), sin(self.heading)]) > 0.0
        if np.hypot(*to_robot) < 1.0 and self._random.random() < 0.02:
            self._goal = self._random.uniform(-0.5 * ROOM_M, 0.5 * ROOM_M, 2)
        way = self._goal - self.place
        turn = wrap_angle(atan2(way[1], way[0]) - self.heading)
        self.heading += float(np.clip(turn, -2.0 * STEP_S, 2.0 * STEP_S))
        pace = 0.0 if in_the_way else PACE if abs(turn) < 1.0 else 0.1
        self.speed += float(np.clip(pace - self.speed, -3.0 * STEP_S, 1.5 * STEP_S))
        self.place = self.place + self.speed * STEP_S * np.array([cos(self.heading), sin(self.heading)])

    def seen(self) -> Ground:
        """As the room told it, some time ago."""
        late = self.speed * LATE_S
        x, y = self.place - late * np.array([cos(self.heading), sin(self.heading)]) + self._random.normal(0.0, 0.01, 2)
        return Ground(float(x), float(y), self.heading)


def walk(seed: int, seconds: float) -> Walked:
    """One run."""
    random = np.random.default_rng(seed)
    drive, pilot = Drive(Ground(3.0, 0.0, pi), seed), Pilot()
    people = [Walker(random) for _ in range(PEOPLE)]
    off, turned = random.normal(0.0, OFF_M, 2), float(random.normal(0.0, OFF_RAD))
    silent_until = lost_until = -1.0
    nearest, errors, headings, free = np.inf, [], [], []
    lost_since = stood_since = None
    told, stood = [np.nan], [np.nan]
    for step in range(int(seconds / STEP_S)):
        t = step * STEP_S
        for person in people:
            person.step(drive.truth)
        drive.step(STEP_S)
        if step % 2 == 0:
            if random.random() < 0.004:
                silent_until = t + random.uniform(0.2, 1.5)
            if random.random() < 0.002:
                lost_until = t + random.uniform(0.5, 4.0)
                lost_since = t if drive.twist != STOP and lost_since is None else lost_since
            if t > silent_until and random.random() > 0.3:
                pilot.own(t - LATE_S, "registered" if t > lost_until else "ambiguous", OFF_M)
                for n, person in enumerate(people):
                    pilot.person(t - LATE_S, f"person{n}", person.seen(), PERSON_SIGMA)
        at = Ground(drive.truth.x + off[0], drive.truth.y + off[1], drive.truth.heading + turned)
        if step == int(BEGINS_S / STEP_S):
            first = people[0]
            pilot.whom = "person0"
            pilot.mirror = mirror_between(Ground(*first.place.tolist(), first.heading), at)
        command = pilot.twist(t, at)
        if random.random() > 0.1:
            drive.command(command)
        if lost_since is not None and command == STOP:
            told.append(t - lost_since)
            stood_since, lost_since = lost_since, None
        if stood_since is not None and drive.twist == STOP:
            stood.append(t - stood_since)
            stood_since = None
        if t > BEGINS_S:
            nearest = min(nearest, *(hypot(*(p.place - [drive.truth.x, drive.truth.y])) for p in people))
        if t > JUDGED_FROM_S and pilot.mirror is not None:
            image = pilot.mirror.image(Ground(*people[0].place.tolist(), people[0].heading))
            errors.append(hypot(image.x - drive.truth.x, image.y - drive.truth.y))
            headings.append(abs(wrap_angle(image.heading - drive.truth.heading)))
            free.append(min(hypot(*(p.place - [image.x, image.y])) for p in people) > FREE_M)
    return Walked(
        float(nearest),
        float(np.median(errors)),
        float(np.median(headings)),
        float(np.median(np.array(errors)[free])) if any(free) else np.nan,
        float(np.median(np.array(headings)[free])) if any(free) else np.nan,
        float(np.nanmax(told)) if len(told) > 1 else np.nan,
        float(np.nanmax(stood)) if len(stood) > 1 else np.nan,
    )


def main() -> None:
    """A table of the runs, least, median and most, and a picture of them all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    runs = [walk(seed, options.seconds) for seed in range(options.runs)]
    columns = {
        "nearest, m": [run.nearest for run in runs],
        "off the image, m": [run.mirror_error for run in runs],
        "off its heading, degrees": [degrees(run.heading_error) for run in runs],
        "off a free image, m": [run.free_error for run in runs],
        "off its heading, free, degrees": [degrees(run.free_heading_error) for run in runs],
        "told to stop after, s": [run.told_after for run in runs],
        "stands after, s": [run.stands_after for run in runs],
    }
    rows = [
        {
            "": name,
            "runs": int(np.isfinite(values).sum()),
            "least": f"{np.nanmin(values):.2f}",
            "median": f"{np.nanmedian(values):.2f}",
            "most": f"{np.nanmax(values):.2f}",
        }
        for name, values in columns.items()
    ]
    print(write_table("robot_among_people", rows, {"runs": options.runs, "seconds": options.seconds}))
    picture(columns)


def picture(columns: dict[str, list[float]]) -> None:
    """How near it came, how far off a free image it was, and how long it took to stand: each run counts once."""
    made, axes = figure(columns=3)
    for ax, name, bound in (
        (axes[0, 0], "nearest, m", NEVER_NEARER_M),
        (axes[0, 1], "off a free image, m", None),
        (axes[0, 2], "stands after, s", STOPS_WITHIN_S),
    ):
        values = np.array(columns[name])
        ax.hist(values[np.isfinite(values)], bins=20, color="#44AA99")
        if bound is not None:
            ax.axvline(bound, color="#333333", linestyle=":", linewidth=1.0, label="aimed at")
            ax.legend()
        ax.set(xlabel=name, ylabel="runs")
        ax.set_xlim(left=0.0)
    made.savefig(FOLDER / "robot_among_people.png", dpi=160)


if __name__ == "__main__":
    main()
