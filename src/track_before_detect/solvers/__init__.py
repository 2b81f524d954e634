"""The detectors of one batch, and what they are made of."""
