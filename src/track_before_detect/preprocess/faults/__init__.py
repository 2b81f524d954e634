"""Pixels and frames that hold no picture, found and named."""
