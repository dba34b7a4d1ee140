"""Other formats into a recording, and a recording or an answer out of it: one module for each format."""
