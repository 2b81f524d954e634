"""The convex detector: subspace pursuit with continuation."""
