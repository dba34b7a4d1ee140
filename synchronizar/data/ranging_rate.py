"""How often radios range, apart from numpy: the command line needs it at start-up."""


def papers_rate_hz(partners: int) -> float:
    """Hz: how often a module of SynchronizAR (Huo et al., UIST 2018) ranges to each of its `partners` partners."""
    return 1000.0 / (80.0 + 21.0 * partners)
