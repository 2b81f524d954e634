"""Reading recordings, writing results."""
