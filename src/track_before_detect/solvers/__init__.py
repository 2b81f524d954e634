"""Solvers of the convex sparsity prior and its continuation."""
