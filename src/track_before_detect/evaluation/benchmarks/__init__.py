"""Timings of ``tbd bench``."""
