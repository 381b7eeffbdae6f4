"""What is learned from motion capture: limits, lengths, torsos and dictionaries of poses."""
