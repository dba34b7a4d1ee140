"""Output for people: evaluation against a truth, tables, plots."""
