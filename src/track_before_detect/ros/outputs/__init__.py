"""Messages of the field, where their packages are installed: vision, radar and Foxglove."""
