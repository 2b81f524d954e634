"""The threshold that belongs to a false alarm rate."""
