"""Every detector on the same scenes."""
