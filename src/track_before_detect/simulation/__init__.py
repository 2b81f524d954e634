"""Simulated scenes with known truth: parameters, motions, what a sensor makes of them, names."""
