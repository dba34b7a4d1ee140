"""Applications, as whole games."""
