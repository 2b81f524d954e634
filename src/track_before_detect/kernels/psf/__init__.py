"""Compiled stamps of a PSF at positions between the pixels, and their statistics."""
