"""A robot that mirrors one of three people who walk about, with a fake clock: how near it comes, how far it is off.

`python -m experiments.apps.robot_among_people [--runs 100] [--seconds 60]`: words of the room come 30 times a second,
60 ms late; 30 % of them are lost, and all of them for up to 1.5 s now and then; the robot's frame is off by 0.1 m and
0.03 rad, as told, and is sometimes not registered for some seconds; one command in ten is lost. People stand still and
turn elsewhere where the robot is in their way within a metre: they walk past it, but not through it. Told is the
nearest that anybody and the robot came (m), and the error of the mirror image in place and heading, median over a run.
"""

from __future__ import annotations

import argparse
from math import atan2, cos, hypot, pi, sin
from typing import NamedTuple

import numpy as np

from experiments.common.markdown import markdown
from synchronizar.apps.robot.drive import Drive, Ground
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


class Walked(NamedTuple):
    """One run."""

    nearest: float
    mirror_error: float
    heading_error: float
    """rad."""


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
    nearest, errors, headings = np.inf, [], []
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
            if t > silent_until and random.random() > 0.3:
                pilot.own(t - LATE_S, "registered" if t > lost_until else "ambiguous", OFF_M)
                for n, person in enumerate(people):
                    pilot.person(t - LATE_S, f"person{n}", person.seen(), PERSON_SIGMA)
        at = Ground(drive.truth.x + off[0], drive.truth.y + off[1], drive.truth.heading + turned)
        if step == int(BEGINS_S / STEP_S):
            first = people[0]
            pilot.whom = "person0"
            pilot.mirror = mirror_between(Ground(*first.place.tolist(), first.heading), at)
        if random.random() > 0.1:
            drive.command(pilot.twist(t, at))
        if t > BEGINS_S:
            nearest = min(nearest, *(hypot(*(p.place - [drive.truth.x, drive.truth.y])) for p in people))
        if t > JUDGED_FROM_S and pilot.mirror is not None:
            image = pilot.mirror.image(Ground(*people[0].place.tolist(), people[0].heading))
            errors.append(hypot(image.x - drive.truth.x, image.y - drive.truth.y))
            headings.append(abs(wrap_angle(image.heading - drive.truth.heading)))
    return Walked(float(nearest), float(np.median(errors)), float(np.median(headings)))


def main() -> None:
    """A table of percentiles over the runs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    runs = [walk(seed, options.seconds) for seed in range(options.runs)]
    rows = []
    for name in Walked._fields:
        values = [getattr(run, name) for run in runs]
        rows.append({"": name, "least": min(values), "median": float(np.median(values)), "most": max(values)})
    print(markdown(rows))


if __name__ == "__main__":
    main()
