"""What the frame publisher plays, and where it is in it."""
