"""Registration while people walk: time to registration and accuracy."""
