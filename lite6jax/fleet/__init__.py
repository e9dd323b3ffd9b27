"""Many arms: every file of a folder or URL fitted or diagnosed, and effects pooled over the arms of one type."""
