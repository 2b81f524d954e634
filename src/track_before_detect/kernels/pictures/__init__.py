"""Compiled loops over the pixels of frames that are prepared for a search."""
