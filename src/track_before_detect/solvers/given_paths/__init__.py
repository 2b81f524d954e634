"""Amplitudes of paths that are given."""
