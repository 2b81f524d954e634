"""Positions between the grid: smooth motions fitted to what a path sees."""
