"""Carrying out the runs of a study and reporting them."""
