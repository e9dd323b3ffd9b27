"""What motions determine of an arm's dynamics through the torques of its joints, and which motions to make."""
