"""The node that makes one set of trajectories of those of several regions of a stream."""
