"""The node that records topics, and the file it writes."""
