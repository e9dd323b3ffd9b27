"""What a recording lacks: every gap with the row after it, the number of missing reports, its length and its reason."""

from dataclasses import dataclass, field

MOST_LISTED = 1000
"""Gaps kept one by one, the longest; the recording itself has all."""


@dataclass(frozen=True)
class Gap:
    """Reports that are missing before a row, or a new run without any.

    Attributes:
        row: the data row after it, from 1.
        run: of that row.
        missing: the number of reports, by the controller's clock, or by this computer's where that one jumps.
        seconds: s, from the row before.
        reason: as a phrase.
        starts_run: whether the run starts with that row.
    """

    row: int
    run: int
    missing: int
    seconds: float
    reason: str
    starts_run: bool


@dataclass
class Gaps:
    """The gaps of a recording, counted.

    Attributes:
        count: how many.
        within: the number of missing reports within runs.
        between: the number of missing reports between runs.
        listed: at least the `MOST_LISTED` gaps with the most missing reports.
    """

    count: int = 0
    within: int = 0
    between: int = 0
    listed: list[Gap] = field(default_factory=list)

    def add(self, gap: Gap) -> None:
        """Counts a gap."""
        self.count += 1
        if gap.starts_run:
            self.between += gap.missing
        else:
            self.within += gap.missing
        self.listed.append(gap)
        if len(self.listed) >= 2 * MOST_LISTED:
            self.listed = self.longest(MOST_LISTED)

    def longest(self, most: int) -> list[Gap]:
        """The gaps with the most missing reports, in the order of their rows."""
        chosen = sorted(self.listed, key=lambda gap: (gap.missing, gap.seconds), reverse=True)[:most]
        return sorted(chosen, key=lambda gap: gap.row)
