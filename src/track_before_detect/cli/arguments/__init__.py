"""Arguments that are more than a line of a parser."""
