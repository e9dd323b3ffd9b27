"""Two results of the same trials side by side: which findings, data faults and errors differ."""

from collections.abc import Iterator, Sequence

from benchmarks.concealed.scores import Row


def differences(before: Sequence[Row], after: Sequence[Row]) -> Iterator[str]:
    """A line for each trial whose findings or data faults differ, then how many agree, and how held-out errors moved.

    Args:
        before: rows of an earlier result.
        after: rows of this one; trials of another truth are left out.
    """
    earlier = {(row["seed"], row["index"], row["sha256"]): row for row in before}
    pairs = [(earlier[key], row) for row in after if (key := (row["seed"], row["index"], row["sha256"])) in earlier]
    agreeing = 0
    for old, new in pairs:
        if _said(old) == _said(new):
            agreeing += 1
        else:
            yield f"trial {new['index']} ({new['kind']}): before {_said(old)}, now {_said(new)}"
    yield f"{agreeing} of {len(pairs)} trials have the same findings and data faults."
    ratios = sorted(new["after_m"] / old["after_m"] for old, new in pairs if old["after_m"] and new["after_m"])
    if ratios:
        moved = sum(abs(ratio - 1) > 0.01 for ratio in ratios)
        yield (
            f"Held-out errors, over those before: median {ratios[len(ratios) // 2]:.4f}, "
            f"{ratios[0]:.3f} to {ratios[-1]:.3f}; {moved} of {len(ratios)} differ by more than 1 %."
        )


def _said(row: Row) -> tuple[list[str], list[str]]:
    findings = [f"{f['effect']}:{f['site']}" + _order(f["order"]) for f in row["findings"]]
    return sorted(findings), sorted(set(row["faults"]))


def _order(order: float | None) -> str:
    return "" if order is None else f" of order {order:.1f}"
