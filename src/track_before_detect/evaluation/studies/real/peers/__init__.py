"""What else finds and links points, for comparison; each needs packages of its own."""
