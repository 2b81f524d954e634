"""What the nodes say, where, and how often."""
