"""Target cancellation, whole and by direction (Guo et al. 2018)."""
