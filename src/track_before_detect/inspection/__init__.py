"""What the detector sees of a recording, in pictures and words."""
