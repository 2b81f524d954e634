"""Positions and amplitudes of bright targets beside the Cramér-Rao bound."""
