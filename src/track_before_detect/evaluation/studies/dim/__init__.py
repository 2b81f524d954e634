"""Dim targets beside an exhaustive search."""
