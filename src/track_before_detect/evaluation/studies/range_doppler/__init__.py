"""Range-Doppler maps with and without the coupling."""
