"""Values without files: tracks, ranges, users, recordings, registrations."""
