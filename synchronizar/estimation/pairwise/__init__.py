"""The method of SynchronizAR (Huo et al., UIST 2018), as a baseline."""
