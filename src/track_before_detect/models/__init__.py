"""What a target looks like and how it may move."""
