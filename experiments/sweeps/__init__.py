"""Parameter sweeps: the paper's method and ours as one condition after another gets harder."""
