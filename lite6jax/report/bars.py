"""Sentences on the standard deviations of predicted poses."""

NO_BARS = (
    "the diagnosis does not say how uncertain its model is, so there are no standard deviations; run `lite6jax "
    "diagnose` again"
)


def outside_sentence(outside: int, rows: int, noun: str) -> str:
    """How many rows are outside what was recorded.

    Args:
        outside: how many are.
        rows: how many there are.
        noun: what a row is called, in the singular.
    """
    if not outside:
        return f"No {noun} is outside what was recorded."
    rows_are = f"{noun}{'' if rows == 1 else 's'} {'is' if outside == 1 else 'are'}"
    return f"{outside} of {rows} {rows_are} outside what was recorded; the standard deviations grow there."
