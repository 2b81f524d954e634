"""What a target looks like in the frames: point spread functions, streaks, several sensors."""
