"""Simulation: scenes, walkers, SLAM, radios, and the air in which the modules' firmware runs; with the truth."""
