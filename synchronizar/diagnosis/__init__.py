"""What looks wrong in a recording, each mistake named as what it is. Nothing here changes a recording."""

from __future__ import annotations

from synchronizar.data.findings import Finding
from synchronizar.data.recording import Recording
from synchronizar.diagnosis.axes import axis_findings, signs_of, with_z_up
from synchronizar.diagnosis.clocks import time_overlap_findings
from synchronizar.diagnosis.levers import lever_findings
from synchronizar.diagnosis.pair_fits import fit_pairs, groups_of
from synchronizar.diagnosis.poses import (
    attitude_findings,
    frozen_pose_findings,
    never_moves_findings,
    pose_gap_findings,
    sparse_pose_findings,
    without_frozen_poses,
)
from synchronizar.diagnosis.radios import swapped_radio_findings
from synchronizar.diagnosis.ranges import no_range_findings, repeated_range_findings
from synchronizar.diagnosis.stamps import in_seconds, stray_stamp_findings, time_unit_findings, without_stray_poses
from synchronizar.diagnosis.units import unit_findings

__all__ = ["findings_of"]


def findings_of(recording: Recording) -> list[Finding]:
    """What can be found without solving anything, the cause before what follows from it.

    What is found first is mended in a copy before the rest is looked for, so that one mistake is reported once.
    """
    found = [*recording.findings, *time_unit_findings(recording)]
    meant = in_seconds(recording)
    found += stray_stamp_findings(meant)
    meant = without_stray_poses(meant)
    found += [
        *time_overlap_findings(meant),
        *no_range_findings(meant),
        *repeated_range_findings(meant),
        *pose_gap_findings(meant),
        *frozen_pose_findings(meant),
        *sparse_pose_findings(meant),
    ]
    meant = without_frozen_poses(meant)
    signs = signs_of(meant)
    found += [*never_moves_findings(meant), *attitude_findings(meant), *axis_findings(meant, signs)]
    meant = with_z_up(meant, signs)
    groups = groups_of(meant)
    in_metres = fit_pairs(meant, groups, free=False)
    units = unit_findings(meant, fit_pairs(meant, groups), in_metres)
    if units:
        return [*found, *units]
    return [*found, *lever_findings(meant, groups), *swapped_radio_findings(meant, in_metres)]
