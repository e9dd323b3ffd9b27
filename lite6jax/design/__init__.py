"""What a set of poses determines, how well, and which poses to record next."""
