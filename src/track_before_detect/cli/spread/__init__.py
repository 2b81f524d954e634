"""Searches that are shared out over workers."""
