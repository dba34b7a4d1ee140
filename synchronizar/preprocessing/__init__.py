"""From a recording to what the solver takes: repaired tracks, keyframes, range measurements."""
