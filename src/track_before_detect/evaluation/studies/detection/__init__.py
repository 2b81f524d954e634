"""Three targets at SNR 3, and noise."""
