"""From raw frames to frames of unit noise on one common plane."""
