"""The evaluation of SynchronizAR (Huo et al., UIST 2018), repeated."""
