"""Factor graphs: the only folder that uses gtsam."""
