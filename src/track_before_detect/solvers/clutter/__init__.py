"""Detection where what is left of a scene is no noise: the strongest paths say what is usual."""
