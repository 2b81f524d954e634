"""Compiled fits of amplitudes: group lasso, least squares, shrinkage."""
