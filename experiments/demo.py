"""Demo: simulates four walkers with drift, jumps and 20 % NLOS ranges, registers, evaluates and plots them.

`python -m experiments.demo [--out demo]` leaves the recording in demo/walk and the answer, with its picture, in
demo/answer.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.io.registration_folder import range_counts, write_registration
from synchronizar.reporting.evaluate import evaluate
from synchronizar.reporting.plots import plot
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

SCENE = Scene(
    users=4,
    seconds=15.0,
    late_share=0.2,
    scale_sigma=0.03,
    bias_sigma=0.05,
    clock_offset_sigma=0.04,
    drift_m_per_sqrt_s=0.01,
    drift_rad_per_sqrt_s=0.005,
    jumps=1,
    seed=3,
)
ROW = "{:8}{:14}{:>8}{:>8}{:>8}{:>9}{:>9}{:>8}{:>8}{:>11}{:>8}{:>8}"
HEAD = ("user", "state", "x", "y", "z", "yaw", "1σ xy", "z", "yaw", "error xy", "z", "yaw")


def main() -> None:
    """From nothing to the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("demo"))
    out = parser.parse_args().out
    walk, answer = out / "walk", out / "answer"

    simulation = simulate(SCENE)
    simulation.save(walk)
    recording = Recording.load(walk)
    registration = register(recording)
    write_registration(registration, recording, answer)

    print(f"{SCENE.users} walkers, {SCENE.seconds:g} s, {simulation.late.mean():.0%} of the ranges NLOS,")
    print("SLAM off in scale, drifting and jumping; frames beside the reference's at the end, m and degrees\n")
    print(ROW.format(*HEAD))
    for name in registration.users:
        print(_row(registration, simulation, name))
    evaluation = evaluate(registration.tracks(recording), simulation.truth, registration.reference)
    print(f"\nall walks against the truth: {evaluation.joint_ate:.3f} m, in the plane {evaluation.joint_ate_xy:.3f} m")
    print("ranges: " + ", ".join(f"{count} {what}" for what, count in range_counts(registration.ranges).items()))
    right = registration.ranges.used != simulation.late
    print(f"NLOS ranges told from the others: {right.mean():.1%} of {len(right)}")
    print("pictures:", *plot(recording, answer, walk.name))


def _row(registration: Registration, simulation: Simulation, name: str) -> str:
    user = registration.users[name]
    covariance = user.covariance
    if user.common_from_user is None or covariance is None:
        return f"{name:8}{user.state}"
    frame = registration.between(registration.reference, name)
    sigma_xy = np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1])
    sigma_z, sigma_yaw = np.sqrt(np.diag(covariance)[2:])
    true = _true_frame(simulation, registration.reference, name)
    return ROW.format(
        name,
        user.state,
        *(f"{value:+.2f}" for value in (frame.x, frame.y, frame.z)),
        f"{np.degrees(frame.yaw):+.1f}",
        *(f"{sigma:.2f}" for sigma in (sigma_xy, sigma_z)),
        f"{np.degrees(sigma_yaw):.1f}",
        f"{np.hypot(frame.x - true.x, frame.y - true.y):.2f}",
        f"{frame.z - true.z:+.2f}",
        f"{np.degrees(wrap_angle(frame.yaw - true.yaw)):+.1f}",
    )


def _true_frame(simulation: Simulation, reference: str, name: str) -> YawFrame:
    return simulation.world_from_user[reference].inverse() @ simulation.world_from_user[name]


if __name__ == "__main__":
    main()
