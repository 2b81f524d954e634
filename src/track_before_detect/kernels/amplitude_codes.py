"""Codes of the amplitude models in compiled loops; what they mean is in the models' module."""

NON_NEGATIVE, SIGNED, CONSTANT, SIGNED_CONSTANT = 0, 1, 2, 3
# From here on frames and amplitudes are complex.
COMPLEX, COMPLEX_CONSTANT = 4, 5
