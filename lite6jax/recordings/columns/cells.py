"""What words in the cells of a table say: whose the numbers beside them are, and which rows are of one state.

`rostopic echo -p` writes the name of a joint or a frame in a column beside its numbers, and the order of names may
change from row to row. A table with a row for each marker repeats the joints and names the marker.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from lite6jax.array_types import AnyArray, Array, Integers
from lite6jax.recordings.columns.names import spoken_words

Words = Sequence[str]
"""One a row; empty where the cell is."""

MOST_WORDS = 64
"""Different words, above which cells are remarks and not names."""
_NAMING = {"name", "names", "joint", "joints", "frame", "id", "ids", "label", "labels", "marker", "body", "child"}
"""In what columns of names are called."""


class NamedColumns(NamedTuple):
    """Columns of numbers, called by the words in cells beside them.

    Attributes:
        columns: all columns of numbers; those that cells name are called `stem.word`.
        in_file: the names of these in the file, where all rows agree; empty where the order of the words changes.
        by: the columns of words.
        words: in the order in which they first stand there.
    """

    columns: dict[str, Array]
    in_file: dict[str, str]
    by: tuple[str, ...]
    words: tuple[str, ...]


def name_by_cells(columns: Mapping[str, Array], words: Mapping[str, Words]) -> NamedColumns | None:
    """The columns of numbers with the names that cells of the same number give them; None where no cells do.

    `name0` names `position0` and `velocity0`, and `transforms1.child_frame_id` names `transforms1.translation.x`.

    Args:
        columns: `(row,)` numbers by name.
        words: of the columns of text, one a row.
    """
    numbered = _group(columns)
    words = _spread_lists(words)
    for names, group in _group(words).items():
        members = _find_members(names, group, numbered)
        cells = np.array([[word.strip() for word in words[name]] for name in group.values()])
        vocabulary = tuple(dict.fromkeys(filter(None, cells.T.ravel().tolist())))
        ordered = np.sort(cells, axis=0)
        repeated = ((ordered[1:] == ordered[:-1]) & (ordered[1:] != "")).any()
        beside = any(stem != names[0] for stem, _, _ in members)
        # of lists of equal length each row names all
        if (
            not members
            or not 0 < len(vocabulary) <= MOST_WORDS
            or repeated
            or (beside and len(vocabulary) != len(group))
        ):
            continue
        new: dict[str, Array] = {}
        in_file: dict[str, str] = {}
        place = {number: k for k, number in enumerate(group)}
        for (stem, suffix, number), name in members.items():
            for word in vocabulary:
                rows = cells[place[number]] == word
                if rows.any():
                    called = f"{stem.rstrip('_.[( ')}.{word}{suffix.lstrip('])')}"
                    before = new.get(called, np.full(len(rows), np.nan))
                    new[called] = np.where(rows, columns[name], before)
                    in_file[called] = name
        constant = all(len({*column} - {""}) == 1 for column in cells.tolist())
        replaced = {*members.values()}
        rest_of_table = {name: column for name, column in columns.items() if name not in replaced}
        return NamedColumns(rest_of_table | new, in_file if constant else {}, tuple(group.values()), vocabulary)
    return None


def _spread_lists(words: Mapping[str, Words]) -> dict[str, Words]:
    """Columns of text with one for each element, `name[0]`, `name[1]`, …, of those that hold lists of equal length."""
    spread: dict[str, Words] = {}
    for name, cells in words.items():
        lists = [[word.strip("'\" ") for word in re.split(r"[,;]\s*|\s+", cell.strip("[]() "))] for cell in cells]
        sizes = {len(elements) for elements in lists}
        listed = all(cell[:1] in "[(" and cell for cell in cells)
        if listed and len(sizes) == 1 and sizes != {1}:
            spread |= {f"{name}[{k}]": elements for k, elements in enumerate(zip(*lists, strict=True))}
        else:
            spread[name] = cells
    return spread


_Groups = Mapping[tuple[str, str], Mapping[int, str]]


def _group(names: Iterable[str]) -> _Groups:
    """Names that differ in their last number alone, by what stands before and behind it."""
    groups: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        if match := re.fullmatch(r"(.*?)(\d+)(\D*)", name, re.DOTALL):
            groups.setdefault((match[1], match[3]), {})[int(match[2])] = name
    return groups


def _find_members(
    names: tuple[str, str], group: Mapping[int, str], numbers: _Groups
) -> dict[tuple[str, str, int], str]:
    """The columns of numbers that a group of columns of words may name, by stem, rest and number."""
    stem, suffix = names
    if _NAMING.isdisjoint(spoken_words(f"{re.split(r'[./]', stem)[-1]} {suffix}")):
        return {}
    members = {}
    for (number_stem, behind), columns in numbers.items():
        structs = number_stem == stem and {*columns} <= {*group}
        numbers_parent = re.split(r"[^./]*$", number_stem)[0]
        names_parent = re.split(r"[^./]*$", stem)[0]
        siblings = numbers_parent == names_parent
        # joint_names stand above the points of a trajectory's state, whose positions they name
        siblings |= "joint" in spoken_words(stem) and numbers_parent.startswith(names_parent)
        lists = siblings and not suffix.strip("])") and not behind.strip("])") and {*columns} == {*group}
        if structs or (lists and len(group) > 1):
            members |= {(number_stem, behind, number): name for number, name in columns.items()}
    return members


# ------------------------------------------------------------------ rows of one state


_LEAST_REPEATED = 1.5
"""Rows a state, on average, of a table with a row for each point: some points are not seen everywhere."""
_LEAST_SINGLE = 0.95
"""Of labels that stand once in their state; of remarks some are repeated."""


class Points(NamedTuple):
    """A table with a row for each state, in which each point has columns of its own.

    Attributes:
        columns: what does not change within a state, and the numbers of the points.
        words: of the columns of text that do not change within a state.
        by: the column of the labels.
        labels: in the order in which they first stand there.
        counts: in how many states each of them stands.
        points: of each label the columns of its numbers, called `LABEL NAME`.
        values: what these were called.
        state: `(row,)`, of which state each row was.
    """

    columns: dict[str, Array]
    words: dict[str, list[str]]
    by: str
    labels: tuple[str, ...]
    counts: tuple[int, ...]
    points: tuple[tuple[str, ...], ...]
    values: tuple[str, ...]
    state: Integers


def spread_points(
    columns: Mapping[str, Array],
    words: Mapping[str, Words],
    state: Sequence[str],
    values: Sequence[str],
    averaged: Sequence[str] = (),
) -> Points | None:
    """A row for each state of a table that has a row for each point and names it; None of other tables.

    Args:
        columns: `(row,)` numbers by name.
        words: of the columns of text.
        state: columns, of numbers or of text, that are equal in all rows of a state.
        values: the columns of numbers that may be of the point; those that do not change within a state are not.
        averaged: columns of numbers whose mean is taken, where they are read anew for each point.
    """
    table = {**columns, **words}
    if not state or not len(table[state[0]]):
        return None
    rows = len(table[state[0]])
    states = _codes(np.stack([_codes(table[name]) for name in state], 1))
    first = np.unique(states, return_index=True)[1]
    if rows < _LEAST_REPEATED * len(first):
        return None
    codes = {name: _codes(of_rows) for name, of_rows in table.items()}
    constant = [name for name, code in codes.items() if (code == code[first][states]).all()]
    values = [name for name in values if name not in constant]
    if not values:
        return None
    for by in (*words, *filter(is_label, columns)):
        label = [word.strip() for word in words[by]] if by in words else write_whole(columns[by])
        labels = tuple(dict.fromkeys(filter(None, label)))
        places = {word: k for k, word in enumerate(labels)}
        named_rows = np.flatnonzero([word != "" for word in label])
        at = np.array([places[label[row]] for row in named_rows], int)
        single = np.unique(states[named_rows] * (len(labels) + 1) + at, return_index=True)[1]
        counts = np.bincount(at[single], minlength=len(labels))
        if (
            by in {*constant, *values}
            or not 2 <= len(labels) <= MOST_WORDS
            or len(single) < _LEAST_SINGLE * len(named_rows)
        ):
            continue
        if np.sort(counts)[-2] < len(first) / 2:
            continue
        spread = {name: columns[name][first] for name in constant if name in columns}
        for name in averaged:
            finite = np.isfinite(columns[name])
            total = np.bincount(states[finite], columns[name][finite], minlength=len(first))
            with np.errstate(invalid="ignore"):
                spread[name] = total / np.bincount(states[finite], minlength=len(first))
        points = []
        for k, word in enumerate(labels):
            of_point = single[at[single] == k]
            for name in values:
                column = np.full(len(first), np.nan)
                column[states[named_rows[of_point]]] = columns[name][named_rows[of_point]]
                spread[f"{word} {name}"] = column
            points.append(tuple(f"{word} {name}" for name in values))
        of_states = {name: [words[name][int(row)] for row in first] for name in constant if name in words}
        return Points(spread, of_states, by, labels, tuple(counts.tolist()), tuple(points), (*values,), states)
    return None


def is_label(name: str) -> bool:
    """Tells whether whole numbers of a column of this name may say which point, pose or marker a row is of."""
    return not _IDENTIFIES.isdisjoint(spoken_words(name))


_IDENTIFIES = {
    *("id", "ids", "nr", "no", "num", "number", "nummer", "name", "label", "point", "points", "pt", "pts", "punkt"),
    *("marker", "tag", "reflector", "smr", "target", "ball", "pose", "position", "posn", "pos", "index", "idx"),
    *("step", "state", "sample", "measurement", "messung", "configuration", "config", "posture"),
}
"""Words of columns of whole numbers that tell rows from each other."""


def _codes(values: Words | AnyArray) -> Integers:
    """`(row,)` whole numbers that are equal where rows are, counted in the order in which these first stand there."""
    _, first, code = np.unique(np.asarray(values), axis=0, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[code.ravel()]


def write_whole(values: Array) -> list[str]:
    """Whole numbers as text, one a row; all empty where one is none."""
    finite = values[np.isfinite(values)]
    if (finite != np.round(finite)).any():
        return [""] * len(values)
    return [f"{value:.0f}" if np.isfinite(value) else "" for value in values]


# ------------------------------------------------------------------ rows of two tables


class Names(NamedTuple):
    """Rows of two tables that have the same name.

    Attributes:
        columns: that hold the names, of either table.
        rows: of each table, in the order of the first.
        alone: names of each table that the other does not have.
    """

    columns: tuple[str, str]
    rows: tuple[Integers, Integers]
    alone: tuple[tuple[str, ...], tuple[str, ...]]


FEWEST_NAMES = 8
"""That two tables share, to be paired by them; the frame and the tool have nine numbers."""


def match_names(first_table: Mapping[str, Words], second_table: Mapping[str, Words]) -> Names | None:
    """The rows of two tables that have the same name in some column; None where they share no names.

    Case and spaces do not matter. Where the names differ, the numbers at their ends do: `P7` and `Point 7`. A name that
    stands in several rows of one table alone is of each of them; in both, the first is of the first.

    Args:
        first_table: columns that may hold names, one a row.
        second_table: likewise.
    """
    matches: list[tuple[int, Names]] = []
    for form in (_plain, _number_at_end):
        for first, second in product(first_table, second_table):
            keys = [[form(word) for word in words] for words in (first_table[first], second_table[second])]
            rows = _matched(*keys)
            if rows is None:
                continue
            shared = {keys[0][row] for row in rows[0]}
            alone = (
                tuple(word for word, key in zip(words, row_keys, strict=True) if key and key not in shared)
                for words, row_keys in zip((first_table[first], second_table[second]), keys, strict=True)
            )
            matches.append((len(rows[0]), Names((first, second), rows, (*alone,))))  # type: ignore[arg-type]
        if matches:
            return max(matches, key=lambda entry: entry[0])[1]
    return None


def _matched(first_names: Sequence[str], second_names: Sequence[str]) -> tuple[Integers, Integers] | None:
    """The rows of two lists of names that belong together, in the order of the first; None where few do."""
    counts = Counter(filter(None, first_names)), Counter(filter(None, second_names))
    shared = counts[0].keys() & counts[1].keys()
    if len(shared) < max(FEWEST_NAMES, min(map(len, counts)) / 2):
        return None
    single = [all(count[name] == 1 for name in shared) for count in counts]
    equal_counts = all(counts[0][name] == counts[1][name] for name in shared)
    if not (any(single) or equal_counts):
        return None
    numbered = [_number_repeats(names, any(single)) for names in (first_names, second_names)]
    if single[1] and not single[0]:
        places = {key: row for row, key in enumerate(numbered[1])}
        pairs = [(row, places[key]) for row, key in enumerate(numbered[0]) if key[0] in shared]
    else:
        rows: dict[tuple[str, int], list[int]] = {}
        for row, key in enumerate(numbered[1]):
            rows.setdefault(key, []).append(row)
        pairs = [(row, partner) for row, key in enumerate(numbered[0]) if key[0] in shared for partner in rows[key]]
    return tuple(np.array(column) for column in zip(*pairs, strict=True))  # type: ignore[return-value]


def _number_repeats(names: Sequence[str], once: bool) -> list[tuple[str, int]]:
    """Names with how often each stood there before; with zero where it is of each row."""
    before: Counter[str] = Counter()
    numbered = []
    for name in names:
        numbered.append((name, 0 if once else before[name]))
        before[name] += 1
    return numbered


def _plain(word: str) -> str:
    return " ".join(word.split()).casefold()


def _number_at_end(word: str) -> str:
    match = re.search(r"(\d+)\D*$", word)
    return str(int(match[1])) if match else ""
