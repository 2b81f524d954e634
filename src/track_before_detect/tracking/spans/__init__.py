"""A recording cut in time into spans of batches, which are searched at the same time."""
