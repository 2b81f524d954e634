"""Shift-and-stack over constant velocities."""
