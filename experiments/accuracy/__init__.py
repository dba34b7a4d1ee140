"""Accuracy and calibration of registrations, on simulated and real recordings."""
