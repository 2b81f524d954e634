"""What several workers gain, and whether they find the same when one of them is killed."""
