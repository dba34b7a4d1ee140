"""The ranging modules' firmware in its simulated air."""
