"""What the arms of one type share: effects pooled over the recordings of many arms, or of one arm over time."""
