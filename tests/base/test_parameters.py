from __future__ import annotations

from dataclasses import fields

import pytest

from synchronizar.parameters import Parameters


def test_other_values_leave_the_rest_as_it_was() -> None:
    changed = Parameters().changed(ranges={"sigma": 0.05}, slam={"keyframe_interval": 2.0})
    assert changed.ranges.sigma == 0.05
    assert changed.slam.keyframe_interval == 2.0
    assert changed.ranges.nlos_share == Parameters().ranges.nlos_share
    assert changed.priors == Parameters().priors


def test_a_value_or_a_subject_that_there_is_not_is_named() -> None:
    with pytest.raises(ValueError, match="ranges has no 'sgima'; there are sigma, "):
        Parameters().changed(ranges={"sgima": 0.05})
    with pytest.raises(ValueError, match="there is no subject 'range'; there are ranges, slam, "):
        Parameters().changed(range={"sigma": 0.05})


def test_every_subject_has_defaults_that_cannot_be_changed() -> None:
    for subject in fields(Parameters):
        value = getattr(Parameters(), subject.name)
        assert value == type(value)()
        with pytest.raises(AttributeError):
            setattr(value, fields(value)[0].name, 1.0)
