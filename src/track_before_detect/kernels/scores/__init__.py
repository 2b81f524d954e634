"""Compiled matched filters: what each position adds to the value of a path."""
