"""What data determine of an arm, how well, and which poses to record or motions to make next."""
