"""What comes in from other nodes, and who sends it."""
