"""Every noise, prior and threshold: the one place where a default stands. One model serves every recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Model:
    """What is known of radios, people and SLAM before anything was measured; lengths m, angles rad, times s."""

    # What a range is like
    range_sigma: float = 0.1
    """1 sigma of an honest range whose recording does not say: the paper's DW1000 figure."""
    late_share: float = 0.2
    """How many ranges are late where nothing tells: they lose their say from about 2.5 sigma on."""
    late_duration: float = 1.0
    """How long (s) a line of sight that is blocked stays so, on average: a body or a pillar between two walkers."""
    late_scale: float = 1.0
    """The typical length of a detour."""
    early_share: float = 0.002
    """How many ranges are too short by more than noise: garbage, since nothing makes a signal early."""
    late_share_clear: float = 0.05
    """How many are late where the first path carries the power (received minus first-path power < 6 dB)."""
    late_share_blocked: float = 0.9
    """How many are late where it does not (> 10 dB), or where the radio says so itself."""
    power_clear_db: float = 6.0
    """DW1000 user manual 4.7: below it line of sight."""
    power_blocked_db: float = 10.0
    """DW1000 user manual 4.7: above it no line of sight."""
    shortest_range: float = -1.0
    """Time-of-flight noise makes a touching pair's range slightly negative; below this a number is no distance."""
    longest_range: float = 1000.0
    """No ultra-wideband radio reaches further."""

    # What tracks are like
    longest_pose_gap: float = 1.0
    """A device's place is interpolated between poses that are this close in time."""

    # Where frames may lie
    height_sigma: float = 0.15
    """How far a SLAM origin may lie above or below the others', 1 sigma: people start it in their hands."""
    static_height_sigma: float = 3.0
    """The same of a radio that stands still: on the floor, on a shelf, under the roof."""
    place_sigma: float = 100.0
    """How far from where the search put it a frame may lie: it says nothing, but keeps the graph solvable."""
    yaw_sigma: float = 1.8
    """The same of its heading: that of any heading being as likely, pi / sqrt(3)."""
    moving: float = 0.5
    """The first user by name that moves more than this is the reference."""

    # How the answer is sought
    most_candidates: int = 16
    """Placements of one user that the search refines."""
    most_searched: int = 128
    """Ranges of one user that the search looks at, evenly chosen; the costs it compares are those of all."""
    most_hypotheses: int = 8
    """Joint placements that are kept while users are added."""
    cost_alive: float = 30.0
    """A placement is kept while its negative log likelihood is at most this much above the best one's."""
    annealing: float = 3.0
    """How many times wider than true the loss is at first, where the answer is in doubt (graduated non-convexity)."""
    doubtful_share: float = 0.02
    """Where more of the ranges than this are taken for late, the answer is looked for again in parts of the walk."""
    parts: int = 24
    """How many parts are tried."""
    most_followed: int = 3
    """Joint placements that are followed from each."""
    least_part: float = 0.3
    """A part is at least this much of the walk,"""
    largest_part: float = 0.6
    """and at most this much, in pieces of a twelfth drawn at random."""

    # When the answer is called good
    cost_excluded: float = 7.0
    """An alternative that is e^-7 times as likely as the best is excluded;"""
    cost_excluded_late: float = 12.0
    """e^-12 times where signals are late: how they are late is known but roughly."""
    largest_error: float = 0.6
    """A placement that is off by more than this, anywhere on the user's own walk, is wrong."""
    largest_yaw_error: float = 0.5
    """A heading that is off by more than this is wrong."""
    wrong_share: float = 1e-3
    """A user is registered when the probability that its placement is wrong is below this."""
    largest_rejected: float = 0.75
    """A user of whose ranges more are rejected is not registered."""
