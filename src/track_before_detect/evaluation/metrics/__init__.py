"""What a study measures: distances, rates, intervals."""
