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
)
from synchronizar.diagnosis.radios import swapped_radio_findings
from synchronizar.diagnosis.ranges import no_range_findings, repeated_range_findings
from synchronizar.diagnosis.stamps import in_seconds, stray_stamp_findings, time_unit_findings
from synchronizar.diagnosis.units import unit_findings
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.suspect_poses import without_frozen_poses, without_stray_poses

__all__ = ["findings_of"]


def findings_of(recording: Recording, parameters: Parameters) -> list[Finding]:
    """What can be found without solving anything, the cause before what follows from it.

    What is found first is mended in a copy before the rest is looked for, so that one mistake is reported once.
    """
    found = [*recording.findings, *time_unit_findings(recording, parameters)]
    meant = in_seconds(recording, parameters)
    found += stray_stamp_findings(meant, parameters)
    meant = without_stray_poses(meant, parameters)
    found += [
        *time_overlap_findings(meant, parameters),
        *no_range_findings(meant),
        *repeated_range_findings(meant, parameters),
        *pose_gap_findings(meant, parameters),
        *frozen_pose_findings(meant, parameters),
        *sparse_pose_findings(meant, parameters),
    ]
    meant = without_frozen_poses(meant, parameters)
    signs = signs_of(meant, parameters)
    found += [
        *never_moves_findings(meant, parameters),
        *attitude_findings(meant, parameters),
        *axis_findings(meant, signs, parameters),
    ]
    meant = with_z_up(meant, signs)
    groups = groups_of(meant, parameters)
    in_metres = fit_pairs(meant, groups, parameters, free=False)
    units = unit_findings(meant, fit_pairs(meant, groups, parameters), in_metres, parameters)
    if units:
        return [*found, *units]
    return [*found, *lever_findings(meant, groups, parameters), *swapped_radio_findings(meant, in_metres, parameters)]
