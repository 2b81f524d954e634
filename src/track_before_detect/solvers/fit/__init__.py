"""Amplitudes of the paths that are held, fitted jointly, and the residual they leave."""
