"""From a recording to the solver's input: repaired tracks, keyframes, range measurements and their weights."""
