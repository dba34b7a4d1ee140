"""Factor graphs: the one place where gtsam is used."""
