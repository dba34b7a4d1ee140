"""Every noise, prior and threshold: the one place where a default stands. One model serves every recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameters:
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

    # What SLAM, radios and clocks do wrong, unless they are trusted
    keyframe_interval: float = 1.0
    """s: how often a pose of its own is estimated; in between SLAM's steps are taken as they are."""
    drift_m_per_sqrt_s: float = 0.007
    """SLAM's random walk, on each axis, also of a device that stands still;"""
    drift_m_per_sqrt_m: float = 0.012
    """and by the way it goes: 0.014 m in the first second of walking, between the 0.02 m of Kim et al. (Sensors 22(24),
    2022, of ARKit) and what recordings with a truth show, 0.002 to 0.02 m."""
    drift_rad_per_sqrt_s: float = 0.0035
    """The same of its heading;"""
    drift_rad_per_sqrt_m: float = 0.006
    """and by the way: 0.007 rad in the first second of walking, between 0.01 rad and 0.001 to 0.007 rad."""
    drift_tail: float = 5.0
    """Degrees of freedom of Student's t, as which steps are distributed: a tracker that slips is no Gaussian."""
    drift_weight: float = 20.0
    """How many steps all this is worth beside those of a walk, where the ranges tell how good a device's SLAM is."""
    jump_sigma_m: float = 0.1
    """How well a step is known that was rebuilt from its neighbours, because SLAM jumped,"""
    jump_sigma_rad: float = 0.1
    """and the turn within it."""
    scale_sigma: float = 0.03
    """Of log scale, of each device: most are metric to a few percent,"""
    scale_common_sigma: float = 0.07
    """and of what all have in common, since devices that walk together are mostly of a kind;"""
    scale_tail: float = 3.0
    """degrees of freedom of Student's t, as which both are distributed: visual-inertial odometry of small robots was
    seen to be 13 to 20 % off, and a tracker without an accelerometer knows no scale at all."""
    bias_sigma: float = 0.05
    """m, of each radio: an antenna delay that is off by 0.2 ns is worth 0.05 m;"""
    bias_common_sigma: float = 0.03
    """and of all: one delay that is set for the whole kind;"""
    bias_tail: float = 20.0
    """of these: with longer tails a radio that is seen from one side only trades bias for distance."""
    clock_sigma: float = 0.04
    """s, of each device's clock against that of the ranges;"""
    clock_common_sigma: float = 0.04
    """and of all: the ranges' own delay;"""
    clock_tail: float = 3.0
    """of these: most are set by a network, to some ms, and stamp at once; some are off by 0.15 s."""
    clock_walk: float = 1e-4
    """s, in a second's root: while people walk. Two quartz clocks that are 20 millionths apart lose 20 us each second,
    which this follows with a lag of some ms."""

    # How the errors of successive ranges hang together
    multipath_sigma: float = 0.15
    """m: what reflections, antennas and bodies add to the noise of an honest range, and keep for a while."""
    multipath_duration: float = 3.0
    """s: for how long. Against the truth, errors a quarter of a second apart were correlated by 0.4 to 0.7 in five
    recordings with four kinds of radio, and by 0.1 to 0.5 after two seconds."""
    multipath_neighbours: float = 1.0
    """s: ranges of a pair that are closer in time tell how strongly their errors are correlated;"""
    multipath_share: float = 0.5
    """the correlation before any was seen,"""
    multipath_weight: float = 20.0
    """worth as many pairs of neighbours."""

    # When SLAM jumps
    jump_least: float = 0.12
    """A smaller jump is left alone: a rebuilt step is itself good to about 0.1 m, so mending it would gain nothing."""
    jump_acceleration: float = 30.0
    """m/s^2, three g: more than hands, wheels and rotors do to a device for as long as a pose takes."""
    jump_spread: float = 2.5
    """A jump exceeds the 95 % quantile of the track's own unrest by this: 7 sigma where that is Gaussian."""
    jump_neighbours: int = 3
    """Steps on either side that say how a device moved; their median stands one that jumped."""
    jump_turn: float = 0.4
    """Where the attitude alone changes by more in one step, SLAM's axes may have turned about the device,"""
    jump_rate: float = 10.0
    """if that is faster (rad/s) than a hand turns it."""
    jump_tilt: float = 0.1
    """SLAM knows gravity to a degree, a rebuilt step to about this: what is less is noise of the step."""
    jump_speed: float = 0.2
    """Velocities (m/s) that differ by less do not tell whether axes turned: a second of walking varies as much."""
    glitch_duration: float = 1.0
    """An attitude that is back within this went wrong by itself: a map that was left is not found again so soon."""

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
    first_stretch: float = 120.0
    """s: of a longer recording, where everybody could be is looked for in so much of it, and followed from there."""
    search_sigma: float = 0.3
    """m: how far ranges may be off in the search that takes SLAM for rigid: drift, scale, clocks, biases."""
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

    # While people walk
    window: float = 20.0
    """s: what is older is carried as a Gaussian, once all are registered (a fixed lag)."""
    search_least: float = 0.5
    """s between two searches for a user who has just come,"""
    search_growth: float = 0.05
    """and this share of the time for which it has been looked for already."""
    check_interval: float = 30.0
    """s: when all are known, how often other placements near theirs, and mirror images, are looked at again."""
    recent: float = 10.0
    """s: a user of whose ranges too many do not fit in so long is looked for again."""

    # When the answer is called good
    cost_excluded: float = 7.0
    """An alternative that is e^-7 times as likely as the best is excluded where SLAM is trusted, e^-(7 sqrt(k)) times
    where the tracks of k devices may be bent by drift;"""
    cost_excluded_late: float = 12.0
    """e^-12 times, or less, where signals are late: how they are late is known but roughly."""
    largest_error: float = 0.6
    """A placement that is off by more than this, anywhere on the user's own walk, is wrong."""
    height_contradicted: float = 4.0
    """Nobody is registered whose height is farther off than so many sigmas of its prior: something else is wrong."""
    largest_yaw_error: float = 0.5
    """A heading that is off by more than this is wrong."""
    wrong_share: float = 5e-3
    """A user is registered when the probability that its placement is wrong is below this."""
    wrong_share_kept: float = 0.05
    """A user that was registered stays so while it is below this: nobody is told something else every second."""
    least_duration: float = 3.0
    """s: while people walk nobody is registered sooner after the first range; few places of a walk prove little."""
    watched_share: float = 0.02
    """A user more of whose last ranges are late is registered when its place has stayed"""
    watched_duration: float = 2.0
    """for so long (s): what a burst of late ranges says is soon contradicted."""
    proven_duration: float = 5.0
    """s: who has been registered for so long is followed; until then other placements are looked for all along."""
    largest_rejected: float = 0.75
    """A user of whose ranges more are rejected is not registered."""
