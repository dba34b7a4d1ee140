"""Experiments: each `python -m experiments.NAME`, seeded, with its figures written to experiments/results/."""
