"""Simulated walks, radios and the firmware's air, with their truth."""
