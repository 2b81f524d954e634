"""Recordings of real cameras whose targets are known."""
