"""Figures 2-7 of US application 18/790,866."""
