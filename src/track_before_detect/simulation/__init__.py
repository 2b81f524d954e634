"""Simulated scenes with known truth: by name, their motions, and what a sensor makes of them."""
