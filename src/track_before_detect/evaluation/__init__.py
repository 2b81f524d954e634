"""Studies over many simulated recordings, and timings."""
