"""Registration while people walk."""
