from __future__ import annotations

import numpy as np
import pytest

from experiments.live.cues import understood

NORTH, EAST = 0.5 * np.pi, 0.0


@pytest.mark.parametrize(
    ("cue", "way", "length"),
    [
        ("walk 2 m straight on", NORTH, 2.0),
        ("walk 1 m to your left", np.pi, 1.0),
        ("walk 3 m back to your right", -0.25 * np.pi, 3.0),
        ("walk 1.5 m towards phone0", EAST, 1.5),
        ("walk 1 m to the right, as you look at phone0", -0.5 * np.pi, 1.0),
    ],
)
def test_a_cue_is_understood_by_its_words(cue: str, way: float, length: float) -> None:
    found, far = understood(cue, NORTH, EAST)
    assert (found, far) == (pytest.approx(way), length)


@pytest.mark.parametrize("cue", ["stay", "walk 2 m up"])
def test_words_that_say_no_way_are_an_error(cue: str) -> None:
    with pytest.raises(ValueError, match=cue):
        understood(cue, NORTH, EAST)
