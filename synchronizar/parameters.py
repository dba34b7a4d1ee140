"""Every noise, prior and threshold, by subject: the one place where defaults stand. One set serves every recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any


@dataclass(frozen=True)
class RangeParameters:
    """What a measured distance is like. Lengths m, times s."""

    sigma: float = 0.1
    """m, 1 sigma of a line-of-sight range whose recording gives none: the DW1000 figure of Huo et al. (UIST 2018)."""
    shortest: float = -1.0
    """m. Time-of-flight noise makes the range of two devices that touch slightly negative; less is no distance."""
    longest: float = 1000.0
    """m: no ultra-wideband radio reaches further."""

    nlos_share: float = 0.2
    """Prior share of NLOS ranges where nothing else is known; with it a range loses its weight from 2.5 sigma on."""
    nlos_share_clear: float = 0.05
    """The same where the first path carries the power (received minus first-path power below `power_clear_db`)."""
    nlos_share_blocked: float = 0.9
    """The same where it does not (above `power_blocked_db`), or where the radio itself reports NLOS."""
    power_clear_db: float = 6.0
    """dB: line of sight below it (DW1000 user manual, 4.7)."""
    power_blocked_db: float = 10.0
    """dB: no line of sight above it (DW1000 user manual, 4.7)."""
    nlos_duration: float = 1.0
    """s: how long a line of sight stays blocked on average, by a body or a pillar between two walkers. Assumed."""
    detour_scale: float = 1.0
    """m: scale of the half-Cauchy distribution of an NLOS range's extra length. Assumed."""
    detour_fluctuation: float = 0.2
    """1 sigma, relative, of the extra length from one range to the next within a burst. Assumed."""
    detour_kept: float = 0.7
    """Probability that the extra length stays the same to the next range of a burst. Assumed."""
    short_share: float = 0.002
    """Share of ranges that are too short by more than noise. Nothing makes a signal early, so they are garbage."""
    foreign_share: float = 0.0005
    """Share of the time in which a pair's ranges are not of these two devices, because radios were exchanged or a radio
    tells an old distance: a few seconds in two hours. Assumed."""
    foreign_duration: float = 4.0
    """s: how long that lasts on average, until the next message or until somebody sees it. Assumed."""
    foreign_speed: float = 2.0
    """m/s, 1 sigma, at which such a distance changes: it is the distance of two others who walk."""
    foreign_scale: float = 10.0
    """m: scale of the half-Cauchy distribution of such distances, the size of a large room. Assumed."""
    foreign_least: float = 0.45
    """m, 1 sigma: an error of this size is none of it, since reflections (three sigmas) and drift make it too."""

    multipath_sigma: float = 0.15
    """m, 1 sigma: slowly varying error of a line-of-sight range from reflections, antennas and bodies."""
    multipath_duration: float = 3.0
    """s: how long it stays. Against the truth, errors 0.25 s apart were correlated by 0.4 to 0.7 in five recordings
    with four kinds of radio, errors 2 s apart by 0.1 to 0.5."""
    multipath_slot: float = 1.0
    """s: in so short a time such an error stays as it is."""
    multipath_correlation: float = 0.5
    """Prior correlation of the errors of neighbouring ranges."""
    multipath_weight: float = 20.0
    """Pairs of neighbours that this prior is worth."""
    multipath_neighbour_gap: float = 1.0
    """s: ranges between the same antennas that are closer in time are neighbours."""
    multipath_most_neighbours: int = 8
    """Neighbours that each range is compared with, at most."""
    multipath_largest_correlation: float = 0.95
    """No measured correlation is taken for more."""
    multipath_chance: float = 1.5
    """Standard deviations of a measured correlation that are put down to chance."""
    pair_weight: float = 50.0
    """Ranges: how many of its own a pair needs for its error size to be taken from them rather than from all pairs."""
    nlos_confusion: float = 4.0
    """c: where a share r of ranges is NLOS the others count 1 / (1 + c r (1 - r)), since some are taken for the other
    kind. Fitted on simulated walks with 0 to 50 % NLOS, whose squared errors were 1.4 to 2 times too large."""
    reflection_confusion: float = 6.0
    """c: where a share x of the variance in line of sight is more than noise, and a share r of ranges is NLOS, the rest
    counts 1 / (1 + c x 4 r (1 - r)), since some of that is NLOS. Fitted on simulated walks with 30 to 50 % NLOS, whose
    squared errors were 4 times too large there; where hardly any range is NLOS, errors beyond noise count in full."""


@dataclass(frozen=True)
class SlamParameters:
    """What a device's own SLAM is like. Lengths m, angles rad, times s."""

    longest_pose_gap: float = 1.0
    """s: a device's place is interpolated between poses that are this close in time."""
    keyframe_interval: float = 1.0
    """s between two keyframes; in between SLAM's motion is taken as it is."""

    drift_m_per_sqrt_s: float = 0.007
    """Random walk of SLAM's position on each axis, by time, also of a device that stands still."""
    drift_m_per_sqrt_m: float = 0.012
    """The same by the way walked: 0.014 m in the first second of walking, between the 0.02 m of Kim et al. (Sensors
    22(24), 2022, of ARKit) and the 0.002 to 0.02 m of recordings with a truth."""
    drift_rad_per_sqrt_s: float = 0.0035
    """Random walk of SLAM's heading, by time."""
    drift_rad_per_sqrt_m: float = 0.006
    """The same by the way walked: 0.007 rad in the first second of walking, between 0.01 and 0.001 to 0.007 rad."""
    drift_dof: float = 5.0
    """Degrees of freedom of Student's t, as which steps are distributed: trackers slip now and then."""
    drift_least: float = 0.022
    """Factor on these figures that stands for SLAM that does not drift."""
    driftless_share: float = 0.3
    """Probability of that, before any range is known."""
    drift_sought_least: float = 0.35
    """Factor by which SLAM is taken to drift at least while optima are sought and compared. Walks that hardly bend hold
    devices at wrong heights."""
    drift_weight: float = 20.0
    """Steps that the drift of all users together is worth where that of a device's own SLAM is estimated."""
    drift_seen_weight: float = 8.0
    """Steps that the usual drift is worth where it is estimated by how much places are corrected while people walk."""
    drift_largest: float = 4.0
    """Factor on usual drift that a device's own is estimated to have at most; more is tried where ranges ask for it."""
    slip_sigmas: float = 5.0
    """Sigmas of a step between keyframes beyond which SLAM slipped."""

    jump_sigma_m: float = 0.1
    """m, 1 sigma of a step that was rebuilt from its neighbours because SLAM re-localised, at most: `jump_spread` times
    the noise level of the track's steps where these are predicted better."""
    jump_sigma_rad: float = 0.1
    """rad, 1 sigma of the turn within it, at most."""
    jump_least: float = 0.12
    """m: a smaller jump is left alone, since a rebuilt step is itself good to about 0.1 m."""
    jump_acceleration: float = 30.0
    """m/s^2: more than hands, wheels and rotors do to a device between two poses."""
    jump_spread: float = 2.5
    """A jump exceeds the 95 % quantile of the track's prediction errors by this: 7 sigma where they are Gaussian."""
    jump_neighbours: int = 3
    """Steps on either side that predict how a device moved; their median withstands one that jumped."""
    jump_turn: float = 0.4
    """rad: where the attitude alone changes by more in one step, SLAM's axes may have turned about the device ..."""
    jump_rate: float = 10.0
    """... if it is faster (rad/s) than a hand turns it."""
    jump_tilt: float = 0.1
    """rad: SLAM knows gravity to a degree, a rebuilt step to about this; a smaller tilt is noise."""
    jump_speed: float = 0.2
    """m/s: velocities that differ by less do not tell whether axes turned; a second of walking varies as much."""
    aligned_turn: float = 0.02
    """rad: attitudes that keep the direction of motion nearer to one body axis than this were computed from it: ..."""
    aligned_share: float = 0.9
    """... so large a share of those of a device that moves, ..."""
    aligned_fewest: int = 10
    """... and so many of them."""
    glitch_duration: float = 1.0
    """s: an attitude that is back within this was wrong by itself; a lost map is not found again so soon."""


@dataclass(frozen=True)
class DeviceParameters:
    """Priors of each device's scale, radio bias and clock: its own deviation, and one that all devices share."""

    flawless_share: float = 0.5
    """Probability that scales, biases and clocks of a recording are all right, before any range is known."""
    faultless_share: float = 0.5
    """Where they are not: probability that all its scales are right; so also biases, and clocks. What is not right is
    as below, times a factor that the ranges tell (`graph.calibration_priors`)."""
    scale_sigma: float = 0.03
    """1 sigma of each device's log scale: most are metric to a few percent."""
    scale_common_sigma: float = 0.07
    """1 sigma of what all have in common, since devices that walk together are mostly of one kind."""
    scale_dof: float = 3.0
    """Degrees of freedom of Student's t for both: visual-inertial odometry of small robots was 13 to 20 % off."""
    bias_sigma: float = 0.05
    """m, 1 sigma of each radio's bias: an antenna delay that is off by 0.2 ns is worth 0.05 m."""
    bias_common_sigma: float = 0.03
    """m, 1 sigma of what all have in common: one delay set for the whole kind."""
    bias_dof: float = 20.0
    """Degrees of freedom for both. With longer tails a radio seen from one side trades bias for distance."""
    known_bias_sigma: float = 0.01
    """m, 1 sigma of a radio's bias that the recording gives, where it does not say how well it is known."""
    clock_sigma: float = 0.04
    """s, 1 sigma of each device's clock against that of the ranges."""
    clock_common_sigma: float = 0.04
    """s, 1 sigma of what all have in common: the ranges' own delay."""
    clock_dof: float = 3.0
    """Degrees of freedom for both: most clocks are set by a network to some ms, some are off by 0.15 s."""
    scale_walk: float = 2e-4
    """per square root of a second: how log scales drift while people walk. Assumed: 1 % in an hour."""
    bias_walk: float = 5e-4
    """m per square root of a second: how radios' biases drift while people walk. Assumed: 0.03 m in an hour."""
    clock_walk: float = 1e-4
    """s per square root of a second: how clocks drift while people walk. Two quartz clocks that are 20 ppm apart part
    by 20 us each second; this follows with a lag of some ms."""


@dataclass(frozen=True)
class PriorParameters:
    """Where frames may lie. Lengths m, angles rad."""

    height_sigma: float = 0.15
    """m, 1 sigma: how far a SLAM origin may lie above or below the others'. People start it in their hands."""
    usual_height_share: float = 0.95
    """Probability that a device starts so, and not on a robot or a stand, or in the hands of who sits: ..."""
    other_height_sigma: float = 1.0
    """m, 1 sigma: ... then it may lie so far above or below the others."""
    level_sigma: float = 0.15
    """m, 1 sigma: how far a device strays from the height at which it is carried, ..."""
    level_duration: float = 5.0
    """s: ... for about so long at a time, ..."""
    level_dof: float = 2.0
    """... with Student's t of so many degrees of freedom, for each device: a drone strays by metres."""
    static_height_sigma: float = 3.0
    """m: the same of a static radio, on the floor, on a shelf, under the roof."""
    highest_begin: float = 20.0
    """m: a track that begins farther above or below its zero has a map's, not its SLAM's."""
    farthest_begin: float = 1000.0
    """m: the common frame is not scaled about the zero of a reference whose track begins farther from it."""
    survey_sigma: float = 0.02
    """m, 1 sigma on each axis of a surveyed radio's place."""
    survey_dof: float = 4.0
    """Degrees of freedom of Student's t: now and then an entry is mistyped, or a radio was moved since."""
    place_sigma: float = 100.0
    """m: prior of a frame's place about where the search put it. It says nothing, but keeps the graph solvable."""
    yaw_sigma: float = 1.8
    """rad: the same of its heading; pi / sqrt(3) is the 1 sigma of an unknown one."""
    least_extent: float = 0.5
    """m: the first user by name that moves more than this is the reference."""


@dataclass(frozen=True)
class SearchParameters:
    """How the answer is searched for. Costs are negative log likelihoods."""

    first_stretch: float = 120.0
    """s: the search looks at so much of a longer recording, and follows what it finds from there."""
    sigma: float = 0.3
    """m: how far ranges may be off while SLAM is taken for rigid: drift, scale, clocks, biases."""
    most_candidates: int = 16
    """Candidates of one user that are refined."""
    most_ranges: int = 128
    """Ranges of one user that candidates are found by, evenly chosen; they are compared by all."""
    most_hypotheses: int = 8
    """Joint candidates kept while users are added."""
    cost_alive: float = 30.0
    """A candidate is kept while its cost is at most this much above the best one's."""
    annealing: float = 3.0
    """How many times wider the loss is at first where the answer is in doubt (graduated non-convexity), or where SLAM
    has drifted in a part of the walk that was added."""
    annealing_of_rigid: tuple[float, ...] = (4.0, 2.0)
    """The same, one after the other, where devices are free and begin at what was found with SLAM taken for rigid."""
    doubtful_share: float = 0.02
    """With more than this share of NLOS ranges the search is repeated in parts of the walk."""
    drifting_share: float = 0.1
    """Where a larger share of ranges seems NLOS, SLAM that drifts many times as far is tried as well."""
    drift_wide: float = 10.0
    """Factor on everybody's drift then: beyond it Student's t reaches, and steps of good SLAM are measured anyway."""
    drift_bent: float = 0.9
    """It is not tried where this share of the ranges that seem NLOS still do once walks have bent so far: among late
    ranges wide drift explains less than a tenth of them."""
    drift_lost: float = 0.6
    """Where a larger share of ranges seems NLOS, everything may be elsewhere, and bending walks says nothing."""
    drift_cost: float = 5.0
    """Log likelihood: so much more must speak for such SLAM than for NLOS ranges; one device in a hundred has it."""
    parts: int = 24
    """Parts that are tried, ..."""
    part_pieces: int = 12
    """... each drawn from so many pieces of the walk, ..."""
    least_part: float = 0.3
    """... at least this share of them ..."""
    largest_part: float = 0.6
    """... and at most this share."""
    most_followed: int = 3
    """Joint candidates that are followed from each part."""
    most_rounds: int = 10
    """Rounds of expectation maximisation from each start, at most, where SLAM is trusted."""
    hopeless_cost: float = 50.0
    """A start whose cost is further above the best is given up: further rounds gain less."""
    mirror_cost_per_range: float = 1.0
    """A mirror image whose cost per range is higher is not followed."""
    mirror_sigmas: float = 3.0
    """Sigmas by which another height must differ to be followed as another optimum."""
    slip_pieces: tuple[int, ...] = (3, 6)
    """Pieces of a walk that are placed anew by themselves, in case SLAM slipped slowly."""
    slip_least_ranges: int = 20
    """Ranges that such a piece needs."""
    slip_gain: float = 15.0
    """Log likelihood that a piece must gain elsewhere."""


@dataclass(frozen=True)
class IncrementalParameters:
    """Registration while people walk. Times s."""

    window: float = 20.0
    """s: what is older is marginalised; while somebody is looked for, what is older than twice this (fixed lag)."""
    search_interval: float = 0.5
    """s between two searches for a user who has just come, ..."""
    search_growth: float = 0.05
    """... and this share of the time for which it has been looked for, if that is more; ..."""
    search_interval_near: float = 0.2
    """... or so many, with the same growth, where the last one says that the next may find it registered."""
    check_interval: float = 30.0
    """s between two checks of known users for other optima and mirror images."""
    doubtful_interval: float = 2.0
    """s between two, while more ranges are NLOS than `search.doubtful_share`: what a burst shows may be elsewhere."""
    search_first: float = 1.0
    """s after the first range until the first search."""
    search_fewest: int = 20
    """Ranges that a search needs: fewer tell nothing worth one."""
    search_proving: float = 2.0
    """s between two searches, at least, while all who are sought are registered and only not proven yet."""
    search_whole_most: int = 12
    """Among so many members, at most, a walk longer than the window is searched; of more it would take too long."""
    judged_walk: float = 3.0
    """s: a user's place is judged where the last so many seconds of its walk would lie; what lies further back was told
    by the frames of its own time."""
    recent: float = 10.0
    """s: what share of a user's ranges is NLOS, or rejected, is asked of the last so many seconds."""


@dataclass(frozen=True)
class IntegrityParameters:
    """When a user is called registered. Lengths m, angles rad, times s; costs are negative log likelihoods."""

    largest_error: float = 0.6
    """m: a placement that is off by more anywhere on the user's own walk is wrong."""
    largest_yaw_error: float = 0.5
    """rad: a heading that is off by more is wrong."""
    wrong_share: float = 5e-3
    """A user is registered when the probability of being wrong in the plane, and in heading, is below this, ..."""
    wrong_height_share: float = 0.015
    """... and in height below this, once all has come: of 870 simulated users one in 40 lay between both limits, none
    of whom was off, and one of nine between this and 0.025; on average of all who are registered it is below 1 in 2000.
    While people walk more ranges will tell, ..."""
    wrong_share_kept: float = 0.05
    """... and stays so while each is below this, so that states do not flicker."""
    cost_excluded: float = 7.0
    """An alternative is excluded when its cost is this far above the best one's, ..."""
    cost_excluded_nlos: float = 12.0
    """... or this far where ranges are NLOS, whose distribution is known but roughly, ..."""
    cost_excluded_sigmas: float = 3.5
    """... and this many standard deviations of what noise makes of the difference where people walk straight lines, so
    that only drift tells one mirror image from the other."""
    height_contradicted: float = 4.0
    """Nobody is registered whose height is more of its prior's sigmas off: something else is wrong."""
    survey_contradicted: float = 0.3
    """m: a surveyed radio that the ranges have further from its entry, and by as many sigmas, is somewhere else."""
    largest_rejected: float = 0.75
    """Nobody is registered of whose ranges a larger share is rejected."""
    share_fewest: int = 20
    """Ranges of a user that a share of them is asked of; of fewer it is chance."""
    largest_short: float = 0.06
    """Nobody is registered of whose ranges a larger share is too short by `innovation_sigmas`: at most 0.001 was where
    tracks are right, among 40 % late ranges and on real recordings, 0.03 to 0.2 where a track was another walk's."""
    largest_short_of_two: float = 0.025
    """The same where two users have so many, the second one without the first one's ranges: at most 0.004 of the second
    was where one radio told short distances for a while, 0.036 where two were exchanged and all were metres off."""
    largest_foreign: float = 0.5
    """Nobody is registered whose foreign ranges, and all between them, are a larger share of its ranges: which part is
    its own is then not known; ..."""
    largest_foreign_of_others: float = 0.75
    """... a larger share than this where they are shared with somebody who is contradicted: either may be the one who
    is elsewhere."""
    largest_foreign_of_all: float = 0.4
    """Nobody at all is registered where a larger share of all ranges is foreign: a third is where two of four are
    exchanged for half the time."""
    largest_drift_m: float = 0.2
    """m in a second of walking, 1 sigma: nobody is registered whose ranges fit its track with farther drift only.
    Odometry simulated up to 20 times as bad as SLAM was measured at 0.17 m and 0.19 rad at most, another walk's track
    at 0.28 m or 0.22 rad at least."""
    largest_drift_rad: float = 0.2
    """rad: the same of its heading."""
    systematic_inflation: float = 2.0
    """With most ranges rejected, nobody is registered whose covariance residuals inflate by more than this."""
    residual_pieces: int = 12
    """Pieces of a recording over which residuals are summed (clustered scores): what stays for longer is no noise."""
    severed_fewest: int = 6
    """Ranges in a row that do not fit before a pair may be severed: fewer are an ordinary burst, ..."""
    severed_honest: float = 10.0
    """... of which so many do not fit for each one that does: a wrong distance is a right one now and then."""
    least_duration: float = 3.0
    """s after the first range before anybody is registered while people walk."""
    watched_share: float = 0.02
    """A user with a larger share of NLOS ranges, ..."""
    watched_drift: float = 2.0
    """... or whose SLAM drifts so many times as far as usual, is registered when its place has stayed ..."""
    watched_duration: float = 2.0
    """... for so many seconds: what a burst says is soon contradicted."""
    innovation_windows: tuple[float, ...] = (1.0, 3.0, 10.0)
    """s: over so long the residuals of ranges before their use are looked at, of those who are followed."""
    innovation_sigmas: float = 3.0
    """Sigmas: further off, such a range is too short, or too long, by more than noise."""
    innovation_short_share: float = 0.1
    """Share of ranges that may be too short; beyond it and chance (three sigmas) a user is not where it seems."""
    innovation_fewest: int = 6
    """Ranges that a share is taken from, at least, ..."""
    innovation_many: int = 20
    """... and so many where that share are misfits of either sign: NLOS comes in bursts of a second."""
    innovation_pair_sigmas: float = 2.0
    """Sigmas: further off, a range of two users does not fit, once somebody is contradicted; ..."""
    innovation_pair_share: float = 0.25
    """... with a larger share of these, the two do not fit one another."""
    shift_steady: float = 0.6
    """s: over so long users are taken to be off by one shift that stays, ..."""
    shift_growing: tuple[float, ...] = (2.0, 4.0)
    """... and over so long by one that grows evenly, as while SLAM slides, or in a train or a lift."""
    shift_sigma: float = 2.0
    """m, 1 sigma of such a shift on each axis."""
    shift_looked_at: float = 5.0
    """Log likelihood by a linear score, which knows no NLOS, from which on the shift of a group is fitted."""
    shift_least: float = 0.2
    """m: a smaller shift is left to the follower."""
    shift_cost: float = 3.0
    """Log likelihood that each registered user costs that is taken to be somewhere else: few of them are."""
    shift_gain: float = 13.0
    """Log likelihood that a shift gains, beside all that bursts of NLOS explain and what it costs, from which on users
    are there; ..."""
    shift_gain_suspected: float = 6.0
    """... and from which on they are not called registered until half of it is gone."""
    shift_gain_apart: float = 3.0
    """Shifts of others that gain less than this below the best may be the true ones too."""
    doubted_duration: float = 30.0
    """s after its ranges contradicted a user in which it is registered again only ..."""
    doubted_share: float = 0.25
    """... while fewer of its latest ranges do not fit: what was wrong may still be, ..."""
    doubted_watched: float = 3.0
    """... and its place has stayed for so many seconds."""
    proven_duration: float = 5.0
    """s: until a user has been registered for so long, other placements are looked for all along."""


@dataclass(frozen=True)
class DiagnosisParameters:
    """When something in a recording is reported as a mistake. Lengths m, angles rad, times s.

    Where no other source is given, a value lies between what simulated and real recordings without the mistake show and
    what the same recordings show with it.
    """

    fewest_poses: int = 10
    """Poses that a track needs before anything is said of its rate, its stamps or its attitudes."""
    still_extent: float = 0.1
    """m: a device whose positions lie within this stands still; SLAM's noise is smaller, a step is longer."""
    still_turn: float = 0.05
    """rad: the same of its attitudes. A device in a hand sways and turns by more."""
    moving_extent: float = 0.5
    """m: a device whose positions extend further was carried about."""
    attitude_noise: float = 1e-3
    """rad: nothing is carried about and turns by less, so that such attitudes were never measured."""
    sparse_interval: float = 0.5
    """s between poses. At an acceleration of 1 m/s^2 a device is 3 cm beside the line between two poses that are 0.5 s
    apart, and 12 cm where they are 1 s apart."""
    gap_intervals: float = 5.0
    """A stretch without poses is longer than so many usual intervals between poses."""

    stray_share: float = 0.02
    """A larger share of the poses that lies apart in time is a part of the walk, and no stray poses, ..."""
    stray_few: int = 3
    """... but so many poses may always be stray."""
    stray_gap: float = 10.0
    """s: stray poses are at least so far from the rest in time, and at least as far as the rest is long."""
    frozen_duration: float = 0.5
    """s: SLAM that repeats one pose for so long has lost tracking, or the device stands still."""
    frozen_jump: float = 0.1
    """m: a repeated pose that ends with a longer step was frozen, ..."""
    frozen_turn: float = 0.1
    """... or with a larger turn (rad), ..."""
    frozen_steps: float = 5.0
    """... where that is also so many times the 90 % quantile of the track's other steps."""

    epoch: tuple[float, float] = (5e8, 1e10)
    """s since 1970: stamps between these count from 1970 (it was 5e8 in 1985), smaller ones from another moment."""
    slowest_rate_interval: float = 4.0
    """s between poses: no SLAM is slower, so that the stamps are no seconds ..."""
    slowest_walk: float = 0.02
    """... where by them the device also moves slower (m/s) than anybody who moves."""
    usual_intervals: tuple[float, float] = (5e-4, 1.0)
    """s between poses: from an inertial unit at 2 kHz to the slowest map. The right unit leads there."""
    covered_right: float = 0.8
    """Share of the ranges that falls within a track's time where their unit is the right one, at least, ..."""
    covered_wrong: float = 0.2
    """... and where it is a wrong one, at most."""
    span_ratio: float = 10.0
    """Ranges whose stamps are in a smaller unit last so many times as long as any track."""
    largest_clock_error: float = 2 * 86400.0
    """s: clocks that count from the same moment are off by time zones or a day; more is another moment."""
    time_zone_tolerance: float = 72.0
    """s: by how much a clock may differ from full hours and still show a time zone."""
    shift_longest: float = 20.0
    """s: while times overlap, a clock is tried by up to so much ahead and behind, ..."""
    shift_step: float = 0.4
    """... first in steps of so much (s), in which a walker comes 0.4 m far, ..."""
    shift_fine_step: float = 0.05
    """... then of so much (s)."""
    shift_least: float = 0.4
    """s: a smaller error is found by the solver itself."""
    shift_rows_kept: float = 0.8
    """Share of a stretch's ranges that a shift must keep: fewer ranges fit better whatever the shift."""
    shift_most_groups: int = 12
    """Stretches that shifts are compared on; more take longer and say the same."""
    shift_most_users: int = 8
    """Moving users whose clocks are tried, at most: the time grows with the square."""

    repeated_share: float = 0.25
    """Share of ranges with the very number of the one before of their pair, above what chance explains."""
    repeated_rows_apart: int = 20
    """Ranges of a pair that are so far apart are equal by chance alone."""
    repeated_fewest: int = 50
    """Ranges that such a share is taken from, at least."""

    axes_fewest_poses: int = 20
    """Poses that a track needs before anything is said of its axes."""
    vertical_concentration: float = 0.8
    """Of the axis about which a device turns, at least: the length of its mean direction in body axes (0 to 1), ..."""
    horizontal_concentration: float = 0.65
    """... and of the other two, at most."""
    flat_share: float = 0.2
    """A walk is flat along an axis where it spreads by less than this share of either other axis, ..."""
    flat_least_spread: float = 0.5
    """... which are at least so much (m, standard deviation)."""
    lower_share: float = 0.4
    """Of two axes the one along which a walk spreads by less than this share of the other is likelier vertical."""
    carried_concentration: float = 0.8
    """Of the direction of motion in body axes, at least, where a device is carried forwards, ..."""
    astray_concentration: float = 0.45
    """... and at most, where its attitudes have nothing to do with how it moves."""
    upside_down: float = -0.5
    """Cosine between a body axis that should point up and the vertical, below which it points down."""
    direction_interval: float = 0.5
    """s over which the direction of motion is taken: half a step of a walker."""
    direction_speed: float = 0.3
    """m/s: slower motion is swaying, and has no direction."""
    direction_fewest: int = 20
    """Directions that a mean needs."""
    direction_most: int = 1000
    """Directions that a mean is taken over, evenly chosen; more say the same."""

    stretch: float = 30.0
    """s: ranges of a pair are fitted in stretches of so much, in which SLAM hardly drifts."""
    stretch_fewest_ranges: int = 30
    """Ranges that a stretch needs: the fit has 12 unknowns."""
    stretch_most_ranges: int = 96
    """Ranges of a stretch that are fitted, evenly chosen."""
    most_stretches: int = 64
    """Stretches that are fitted, evenly chosen: they bound the time on a long recording."""
    fewest_stretches: int = 2
    """Stretches that have to agree before two radios or a lever arm are reported."""
    fit_passes: int = 5
    """Reweighted least-squares steps of a fit, after which its weights change no more."""
    fit_correlation: float = 3.0
    """Factor on the variance of a fit, whose errors are correlated by multipath."""
    fit_nearest: float = 0.25
    """Shorter distances than this share of the median weigh like it: the square of a distance near 0 says nothing."""
    soft_sigmas: float = 2.0
    """sigma: scale of the Cauchy loss of these fits and of the adjustment."""
    misfit: float = 0.2
    """m: where radios, clocks and lengths are right, ranges fit better than this (robust 1 sigma)."""
    misfit_left: float = 0.5
    """Share of the misfit that an explanation may leave: the right one leaves the ranges' noise alone."""
    most_users: int = 12
    """Users of a recording in which radios are exchanged, or a solution is adjusted: the time grows with the square."""
    swap_worse: float = 1.1
    """No stretch may fit worse by this factor when two radios are exchanged."""
    lever_least: float = 0.1
    """m: a shorter lever arm makes no difference that ranges show."""
    lever_left: float = 0.8
    """Share of the misfit that is left with lever arms in a camera's axes, on average, at most, ..."""
    lever_worse: float = 1.15
    """... and in no stretch more than this."""

    unit_odds: float = 8.0
    """A unit is reported where its log likelihood is so far above that of any other, metres among them."""
    unit_odds_one: float = 3.0
    """The same of one track, where the others are known to be in metres."""
    unit_share: float = 0.5
    """Share of the fits, by weight, that agrees with the unit ..."""
    unit_factor: float = 1.35
    """... within this factor (of lengths)."""
    unit_largest_weight: float = 4.0
    """No fit counts for more than so many times the median one."""
    unit_scale_sigma: float = 0.3
    """1 sigma, relative, of the square of a scale: SLAM's own scale may be 15 % off."""
    unit_fit_inflation: float = 1.5
    """Factor on a fit's own 1 sigma, which is too small where ranges are NLOS."""
    unit_fit_dof: float = 3.0
    """Degrees of freedom of Student's t, as which errors of the fits are distributed."""
    unit_known_sigmas: float = 4.0
    """Sigmas from 0 from which on the devices' own motion says how long the ranges' unit is."""
    unit_misfit: float = 0.15
    """m: where all lengths are metres, the ranges of a track fit better than this."""
    fastest: float = 15.0
    """m/s: nothing within reach of a short-range radio moves faster for long."""
    speed_interval: float = 1.0
    """s over which a speed is taken."""
    usual_speed: float = 0.7
    """m/s, of a walker who looks about: millimetres and centimetres are told apart by it."""
    usual_distance: float = 5.0
    """m between two devices in a room: the same."""
    largest_noise: float = 3.0
    """m: where ranges spread by more (robust 1 sigma), they are not in metres."""
    farthest: float = 100.0
    """m: where devices move, ranges with such a noise are not in metres only if their median is longer than this."""

    adjustment_fewest_ranges: int = 40
    """Ranges that an adjustment of heights and antenna delays needs."""
    adjustment_most_ranges: int = 800
    """Ranges that are adjusted, evenly chosen."""
    adjustment_sigmas: tuple[float, float, float, float, float, float] = (10.0, 10.0, 3.0, 3.0, 0.5, 0.05)
    """1 sigma of its priors of x, y, z (m), yaw (rad), range bias (m) and log scale. They say next to nothing, but keep
    what ranges do not determine; the scale is held near 1, for a solution may have bent it to make up for a delay."""
    adjustment_static_factor: float = 2.0
    """The height of a static radio has its own prior, wider by this."""
    adjustment_held_sigma: float = 0.03
    """m, 1 sigma of heights, or of delays, while they are held at what the priors expect."""
    adjustment_steps: int = 12
    """Gauss-Newton steps from each start, at most."""
    adjustment_least_sigma: float = 0.03
    """m: no radio is better."""
    adjustment_correlation: float = 4.0
    """Ranges whose errors are correlated (multipath, drift) count for a fourth."""
    adjustment_heights: tuple[float, ...] = (-1.4, -0.7, 0.7, 1.4)
    """m: starts with one origin so much higher. A level walk feels a height by its square, so that 0 is stationary."""
    adjustment_biases: tuple[float, ...] = (-0.25, 0.25)
    """m: starts with all radios' biases at this."""
    adjustment_kept: int = 6
    """Best minima of these starts that are looked at."""
    adjustment_rejected: float = 10.0
    """Evidence is divided by 1 + this times the share of rejected ranges: with many, some that are used are wrong."""
    mirror_evidence: float = 3.0
    """Log likelihood within which the other side, higher or lower, fits as well, ..."""
    mirror_share: float = 0.5
    """... where the height there is at least this share of the first one's."""
    height_evidence: float = 5.0
    """Log likelihood that usual heights must cost before a height is reported, ..."""
    height_sigmas: float = 3.0
    """... which besides is so many of its own height_sigma away from the others' mean."""
    height_evidence_lost: float = 3.0
    """The same of a user that is not registered, where a height is an explanation, ..."""
    height_sigmas_lost: float = 2.0
    """... and so many of its height_sigma."""
    bias_evidence: float = 4.0
    """Log likelihood that usual delays must cost before a delay is reported."""
    largest_common_bias: float = 0.25
    """m, of both radios of a pair together: calibrated radios are not further off, on average."""
    largest_own_bias: float = 0.25
    """m by which one calibrated radio differs from the others, at most."""
    own_bias_sigmas: float = 5.0
    """Sigmas by which it differs, besides."""
    suspect_share: float = 0.5
    """Where all users are registered, a solution is adjusted if a height or a bias exceeds this share of its limit."""


@dataclass(frozen=True)
class SleepParameters:
    """When a room's modules sleep. Times s."""

    settled: float = 20.0
    """For so long somebody has to be registered and sure of their place before their module may sleep: a check of known
    users comes 5 s after registration, and what contradicts a place is seen within seconds of walking."""
    sigma: float = 0.15
    """m in the plane: so sure they have to be, ..."""
    wake_sigma: float = 0.3
    """... and are woken when they are less sure than this. SLAM's drift adds to sigma while nobody ranges."""
    nap: float = 20.0
    """Modules wake at its multiples: as long a joiner waits at most."""
    shortest_nap: float = 5.0
    """Start and Wi-Fi take 2.4 s: shorter naps save nothing."""
    glance: float = 1.0
    """A module ranges for so long when it has woken, before it is told to sleep again."""
    gone: float = 3.0
    """One that was not heard for so long, and is, has woken: who is awake says something each second."""
    partners: float = 600.0
    """Who ranged with somebody within so long is near enough to be woken for them."""
    unheard: float = 60.0
    """Who is in need keeps others awake only while their module was heard within so long, a few naps."""
    range_on_every: float = 3.0
    """A module sleeps by itself after 10 s without an order."""
    sleep_every: float = 1.0
    """An order to sleep that was lost is given again."""


@dataclass(frozen=True)
class SmoothingParameters:
    """How the frame that a page shows follows the one that is solved (`live.smoothing`)."""

    dead_band: float = 0.01
    """m: an error of the shown frame that nobody sees. It is left alone, as is one of less than 1 sigma, ..."""
    arm: float = 3.0
    """m: how far away things stand that a turn or a scale moves."""
    settled: float = 0.5
    """... but what is followed is followed down to this share of the dead band: seldom, and then all the way."""
    least_speed: float = 0.02
    """m/s at which things may always move, ..."""
    rate: float = 0.2
    """1/s: ... and this times their error besides."""
    people: float = 5.0
    """Times as fast where only people are on the screen: they walk, and what is corrected is not told from a step."""
    out_of_view: float = 10.0
    """Times as fast where nothing that would move is on the screen."""
    fade_beyond: float = 0.5
    """m: from here on things fade out, and in again where they belong."""
    fade_time: float = 0.3
    """s that either takes."""
    alarm_least: float = 0.1
    """m: no correction below it is told to people."""
    alarm_sigmas: float = 5.0
    """A correction beyond this many sigmas, by what was told, is told."""
    alarm_memory: float = 10.0
    """s: what is held against a frame is what was told so long ago at most, so that creeping is noticed too."""


@dataclass(frozen=True)
class Parameters:
    """What is assumed of radios, SLAM, devices and people before anything is measured, and how the answer is found."""

    ranges: RangeParameters = field(default_factory=RangeParameters)
    slam: SlamParameters = field(default_factory=SlamParameters)
    devices: DeviceParameters = field(default_factory=DeviceParameters)
    priors: PriorParameters = field(default_factory=PriorParameters)
    search: SearchParameters = field(default_factory=SearchParameters)
    incremental: IncrementalParameters = field(default_factory=IncrementalParameters)
    integrity: IntegrityParameters = field(default_factory=IntegrityParameters)
    diagnosis: DiagnosisParameters = field(default_factory=DiagnosisParameters)

    def changed(self, **subjects: Mapping[str, Any]) -> Parameters:
        """The same with other values: `Parameters().changed(ranges={"sigma": 0.05})`.

        Raises ValueError for a subject or a value that there is not.
        """
        own = [f.name for f in fields(self)]
        for subject, values in subjects.items():
            if subject not in own:
                raise ValueError(f"there is no subject {subject!r}; there are {', '.join(own)}")
            known = [f.name for f in fields(getattr(self, subject))]
            if unknown := [name for name in values if name not in known]:
                raise ValueError(f"{subject} has no {unknown[0]!r}; there are {', '.join(known)}")
        return replace(self, **{name: replace(getattr(self, name), **values) for name, values in subjects.items()})
