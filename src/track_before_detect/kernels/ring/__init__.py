"""Compiled dynamic programming over whole pixels (Fu et al. 2022)."""
