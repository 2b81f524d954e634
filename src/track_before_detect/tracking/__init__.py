"""From frames to trajectories: batches, detection, identities."""
