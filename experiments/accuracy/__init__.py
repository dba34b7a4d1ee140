"""How good the answers are, on simulated and real recordings."""
