"""Work that is shared out over processes and machines, and what of it is kept."""
