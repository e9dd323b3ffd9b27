"""Tables of text: where one stands in its file, its names and units, and its numbers, read by Arrow.

The body is the rows of one width that hold most numbers. The rows directly above it are its names: several are joined,
a row of units is added to them. Whatever stands higher is not read. Only the first lines of a file are looked at.
"""

import codecs
import csv
import io
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence, Set
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.csv as pa_csv

from lite6jax.errors import InputError
from lite6jax.recordings.columns.column import LABELS, units_of
from lite6jax.recordings.columns.documented import is_standard
from lite6jax.recordings.columns.names import unit_of
from lite6jax.recordings.pairs import holds_pairs, read_pairs
from lite6jax.recordings.parquet import one_line
from lite6jax.recordings.table import RawTable, Values, like_a_clock

LINES = 120
"""Looked at, from the start of a file."""
SPACES = " "
"""The delimiter of columns between which any number of spaces and tabs stands."""
_DELIMITERS = (",", ";", "\t", "|", SPACES)
LINE_BREAK = re.compile(r"\r\n|[\r\n]")
_NUMBER = re.compile(r"[-+]?[\d.,]*\d\.?(?:e[-+]?\d+)?", re.IGNORECASE)
_MISSING = {"", "nan", "-nan", "inf", "-inf", "na", "n/a", "#n/a", "null", "none"}
_QUOTED_LIST = re.compile(
    r'"\s*(?:array(?:\(\'\w\',)?)?\s*(?=[^"]*\d)([\[(][-+\d.,;eEnaif\s\[\]()]*[\])])(?:,\s*dtype=\w+\))?\s*"'
)
_LIST = re.compile(r"(?<![^,;|\t\r\n]) *([\[(](?=[^\[\]()]*\d)[-+\d.,;eEnaif\s]*[\])]) *(?![^,;|\t\r\n])")
_ELEMENT = "\x01"
_BRACKETS = "[](){}<> "
_NO_UNITS = {"", "-", "--", "—", "1", "%"}
_OTHER_UNITS = {"in", "inch", "k", "v", "w", "hz", "rpm", "bar", "count", "counts", "ticks", "bool"}
_LABELS = {"type", "name", "id", "parent"}
_WITHOUT_A_NAME = {"type", "id", "parent"}
_LENGTHS = re.compile(r"\bLength Units\W+(\w+)", re.IGNORECASE)
_ANGLES = re.compile(r"\bRotation Type\W+([XYZ]{3})\b", re.IGNORECASE)

Row = list[str]


class Layout(NamedTuple):
    """A table within a text.

    Attributes:
        names: of its columns; `column_1`, `column_2`, … where it names none.
        delimiter: between fields.
        fields: in a row; those after the last name are empty.
        decimal: the mark of decimals.
        skip: the number of lines above its body.
        lists: whether fields hold lists, whose numbers are a column each.
        nameless: whether it names no column at all.
    """

    names: tuple[str, ...]
    delimiter: str
    fields: int
    decimal: str
    skip: int
    lists: bool
    nameless: bool


def find_table(text: str, source: str, notes: list[str]) -> Layout:
    """The table in a text.

    Args:
        text: its first lines, whole.
        source: what messages begin with.
        notes: gets a sentence for what is skipped, joined or added to names.

    Raises:
        InputError: lengths in a unit that no column may have, or names and a row of units that differ.
    """
    text = "\n".join(LINE_BREAK.split(text, LINES)[:LINES])
    lists = (marked := mark_lists(text)) != text
    text = marked
    lines = text.split("\n")
    possible = [mark for mark in _DELIMITERS if mark in (",", SPACES) or mark in text]
    blocks = {mark: _block(lines, mark) for mark in possible}
    if "\t" in blocks and _is_even(blocks["\t"]):
        del blocks[SPACES]  # which stand within the cells
    delimiter, rows, width, _ = max(blocks.values(), key=lambda block: block[3])
    body = _body(rows, width)
    if body is None:
        return _of_names_alone(lines)
    within = [row for row in rows[body:] if len(row) == width]
    sizes = [max(row[k].count(_ELEMENT) for row in within) + 1 for k in range(width)]
    filled = max((k + 1 for row in within for k, cell in enumerate(row) if cell), default=width)
    top, header = _header(lines, body, delimiter, width, filled)
    table = Layout((), delimiter, sum(sizes), _decimal(within, delimiter), body, lists, not header)
    if not header:
        return _without_names(table, lines, rows, sum(sizes[:filled]), notes)
    _say_above(lines[:top], notes)
    names = _names(header, lines[:top], source, range(top + 1, body + 1), notes)
    while names and not names[-1] and len(names) > filled:
        names.pop()
    if lists:
        sized = zip(names, sizes, strict=False)
        names = [f"{name}[{k}]" if size > 1 else name for name, size in sized for k in range(size)]
        if example := next((name for name in names if name.endswith("[0]")), ""):
            notes.append(f"lists are read as a column for each of their numbers, such as {example!r}")
    return table._replace(names=_unique(names, notes))


def _without_names(table: Layout, lines: Sequence[str], rows: Sequence[Row], columns: int, notes: list[str]) -> Layout:
    """A table above which no row names each of its columns."""
    body = table.skip
    above = next((row for row in reversed(rows[:body]) if any(row)), [])
    is_header = len(above) > 1 and {*map(_kind, above)} <= {"text", ""}
    if is_header and (table.delimiter != SPACES or len(above) in map(len, rows[body:])):  # another number of them
        listed = _continue_lists(_unique(above, []), max(map(len, rows[body:])))
        return table._replace(names=listed, fields=len(listed), nameless=False)
    counted = [str(k) for k in range(len(rows[body]) + 1)]
    numbered = rows[body] in (counted[:-1], counted[1:]) and "number" in map(_kind, (rows[body + 1 :] or [[]])[0])
    if numbered:
        notes.append(f"line {body + 1} counts the columns and is not read")
    _say_above(lines[:body], notes)
    return table._replace(names=tuple(f"column_{k + 1}" for k in range(columns)), skip=body + numbered)


def _element(name: str) -> tuple[str, int] | None:
    """The list and the number of the element to which a column belongs, by its name; None where it names none."""
    match = re.fullmatch(r"(.*?)(\d+)\D*", name, re.DOTALL)
    return (match[1], int(match[2])) if match else None


def _continue_lists(names: tuple[str, ...], fields: int) -> tuple[str, ...]:
    """Names with those of further elements of the list at their end, where rows hold such beyond them."""
    last = _element(names[-1])
    columns = [name for name in names if _element(name) == last]
    surplus = fields - len(names)
    if last is None or surplus <= 0 or surplus % len(columns) or names[-len(columns) :] != tuple(columns):
        return names
    stem, number = last
    numbers = range(number + 1, number + 1 + surplus // len(columns))
    return (*names, *(f"{stem}{k}{name[len(f'{stem}{number}') :]}" for k in numbers for name in columns))


def _ends_a_list(names: Sequence[str], fields: int) -> bool:
    """Tells whether rows of so many fields lack whole elements at the end of lists: messages of unequal length."""
    present = {_element(name) for name in names[:fields]}
    lacking = Counter(_element(name) for name in names[fields:])
    stems = {element[0] for element in present if element}
    whole_elements = not present & lacking.keys() and all(element and element[0] in stems for element in lacking)
    return whole_elements and min(lacking.values(), default=0) > 1


def mark_lists(text: str, mark: str = _ELEMENT) -> str:
    """A text in which the numbers of each list of numbers stand between marks, without brackets and quotes."""

    def plain(match: re.Match[str]) -> str:
        if "," in match[1] and ";" in match[1]:  # decimal commas
            return match[0]
        return mark.join(re.findall(r"[^\s,;\[\]()]+", match[1]))

    return _LIST.sub(plain, _QUOTED_LIST.sub(plain, text))


def _block(lines: Sequence[str], delimiter: str) -> tuple[str, list[Row], int, float]:
    """Lines as rows, the width of those that hold most numbers, and how many that are, less where texts are among."""
    rows = [_split(line, delimiter) for line in lines]
    scores: dict[int, float] = defaultdict(float)
    for row in rows:
        kinds = Counter(map(_kind, row))
        numbers = kinds["number"] + kinds["integer"]
        if numbers and (delimiter != SPACES or numbers >= kinds["text"]):  # no prose
            scores[len(row)] += numbers**2 / (numbers + kinds["text"])
    width = max(scores, key=lambda key: scores[key], default=0)
    return delimiter, rows, width, scores[width]


def _is_even(block: tuple[str, list[Row], int, float]) -> bool:
    """Tells whether a block's rows and the names above them are all there is, with two numbers or more in each row."""
    _, rows, width, _ = block
    filled = [[*map(_kind, row)] for row in rows if any(row)]
    numbers = [kinds.count("number") + kinds.count("integer") for kinds in filled[1:] if len(kinds) == width]
    return width > 1 and [*map(len, filled)] == [width] * len(filled) and min(numbers, default=0) > 1


def _split(line: str, delimiter: str) -> Row:
    if delimiter == SPACES:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [""])]
    except csv.Error:
        return [line]


def _kind(cell: str) -> str:
    """`number`, `integer`, `text`, or nothing where a value is missing."""
    if cell.lower() in _MISSING:
        return ""
    if cell.lstrip("+-").isdecimal():
        return "integer"
    number = _ELEMENT in cell or _NUMBER.fullmatch(cell) or (cell[0].isdecimal() and like_a_clock(cell))
    return "number" if number else "text"


def _body(rows: Sequence[Row], width: int) -> int | None:
    """The first row of numbers; None where there is none."""
    kinds = [[*map(_kind, row)] for row in rows]
    of_width = [k for k, row in enumerate(kinds) if len(row) == width]
    if not width or not of_width:
        return None
    fullest = max(of_width, key=lambda k: (sum(kind in ("number", "integer") for kind in kinds[k]), k))
    of_numbers = [k for k, kind in enumerate(kinds[fullest]) if kind in ("number", "integer")]

    def holds_numbers(row: int) -> bool:
        number_kinds = [kinds[row][k] for k in of_numbers]
        texts = number_kinds.count("text")
        if not texts:
            return any(number_kinds)
        return texts < len(number_kinds) / 2 and (
            "number" in number_kinds or texts < len(number_kinds) / 4
        )  # a row with damage

    inside = [holds_numbers(k) for k in of_width]
    decimals = ["number" in (kinds[row][k] for k in of_numbers) for row in of_width]  # numbers in names are whole
    first = next(
        (k for k, numeric in enumerate(inside) if numeric and (decimals[k] or all(inside[k + 1 : k + 2]))), None
    )
    if first is None:
        return None
    body = of_width[first]
    while body:
        above = kinds[body - 1]
        if len(above) == width:  # whose numbers are missing, or damaged
            number_kinds = [above[k] for k in of_numbers]
            within = "text" not in number_kinds or "number" in number_kinds
        else:  # cut short, too long, or of fewer elements
            same_pattern = [kind == "text" for kind in above] == [
                kind == "text" for kind in kinds[fullest][: len(above)]
            ]
            within = any(above) and ("text" not in above or ("number" in above and same_pattern))
        if not within:
            break
        body -= 1
    return body


def _header(lines: Sequence[str], body: int, delimiter: str, width: int, filled: int) -> tuple[int, list[Row]]:
    """The first line of the names, and their rows from the top; columns after the `filled` ones may have none."""
    header: list[Row] = []
    top = row = body
    while row:
        row -= 1
        line = lines[row].strip(" ")
        comment = line[:1] in ("#", "%")
        line = line.lstrip("#%").strip(" ") if comment else line
        if not any(cell.strip("-=_ ") for cell in _split(line, delimiter)):  # blank, or a rule
            if header:
                break
            continue
        alone = comment or delimiter == SPACES or width == 1
        cells = _fitting(line, delimiter, width, filled, any_delimiter=alone)
        kinds = {*map(_kind, cells or ())}
        if "number" in kinds or not (header or "text" in kinds) or not cells:
            if comment and not header:
                continue
            break
        top = row
        header.insert(0, cells)
        if alone and not (len(header) == 1 and _of_units(cells)):
            break
    while header and width > 1 and not any(header[-1][1:]):  # the name of an index, or a title
        header.pop()
    return top if header else body, header


def _fitting(line: str, delimiter: str, width: int, filled: int, any_delimiter: bool) -> Row | None:
    """The names in a line, as many as there are columns; None where they are not."""
    cells = _split(line, delimiter)
    while len(cells) > width and not cells[-1]:
        cells.pop()
    if filled <= len(cells) <= width:
        return cells + [""] * (width - len(cells))
    wide = [cell.strip() for cell in re.split(r"\s{2,}|\t", line.strip())]
    splits = [wide, *(_split(line, mark) for mark in _DELIMITERS)] if any_delimiter else []
    return next((cells for cells in splits if len(cells) == width), None)


def _names(header: list[Row], above: Sequence[str], source: str, lines: range, notes: list[str]) -> list[str]:
    """One name a column, from rows of names and perhaps of units."""
    units = header[-1] if len(header) > 1 and _of_units(header[-1]) else None
    rows = header[:-1] if units else header
    parts = [part for row in rows[:-1] if (part := _group_names(row)) is not None] + [rows[-1]]
    names = [
        "/".join(part for k, part in enumerate(column) if part and part not in column[k + 1 :])
        for column in zip(*parts, strict=True)
    ]
    names = _with_heads(names)
    if units:
        names = [_with_unit(name, unit, source) for name, unit in zip(names, units, strict=True)]
    names = _with_stated_units(names, "\n".join(above), source)
    if units:
        example = next((name for name in names if name.endswith("]")), "")
        added = f", which are added to the names, such as {example!r}" if example else ""
        notes.append(f"line {lines[-1]} holds units{added}")
    if len(parts) > 1:
        deepest = max(names, key=lambda name: name.count("/"))
        notes.append(f"names are joined from lines {lines[0]} to {lines[-1]}, such as {deepest!r}")
    return names


def _group_names(row: Row) -> Row | None:
    """A row above the names proper, each of its names over the empty fields after it; None where it names nothing."""
    filled = [k for k, cell in enumerate(row) if cell]
    label = row[filled[0]].lower()
    if label in _WITHOUT_A_NAME or filled == [0] or not any(_kind(cell) == "text" for cell in row):
        return None
    row = [*row]
    if label in _LABELS and len(filled) > 1:
        row[filled[0]] = ""
    last = ""
    for k, cell in enumerate(row):
        last = cell or last
        row[k] = last
    return row


def _with_heads(names: Sequence[str]) -> list[str]:
    """With a body's name before all that is of it, where it stands before X alone: `Tool X`, `Y`, `Z`, `Roll`."""
    head = ""
    full_names = []
    for k, name in enumerate(names):
        match = re.fullmatch(r"(.+ )X", name)
        if match and [*names[k + 1 : k + 3]] == ["Y", "Z"]:
            head = match[1]
            full_names.append(name)
        else:
            full_names.append(head + name if name else name)
    return full_names


def _of_units(row: Iterable[str]) -> bool:
    """Tells whether all that a row holds are units."""
    any_unit = False
    for cell in filter(None, row):
        unit = cell.strip(_BRACKETS)
        is_bare = not set("[](){}") & set(unit)  # `J1 [deg]` is a name with a unit
        is_unit = is_bare and (unit_of(f"x [{unit}]") is not None or unit.lower() in _OTHER_UNITS)
        is_unit = is_unit or (cell[0] + cell[-1] in ("[]", "()", "{}", "<>") and _kind(unit) == "text")
        if not is_unit and unit not in _NO_UNITS:
            return False
        any_unit = any_unit or is_unit
    return any_unit


def _with_unit(name: str, cell: str, source: str) -> str:
    unit = cell.strip(_BRACKETS)
    if unit in _NO_UNITS:
        return name
    named_unit = unit_of(name)
    stated = unit_of(f"x [{unit}]")
    if named_unit is not None and named_unit == stated:
        return name
    if named_unit is not None and stated is not None and len(named_unit) > 1:
        raise InputError(f"{source}: column {name!r}: the row of units says {unit!r}; correct the name or the unit")
    return f"{name} [{unit}]"


def _with_stated_units(names: list[str], above: str, source: str) -> list[str]:
    """With the units that lines above the table state for all lengths and angles."""
    turned = "deg" if _ANGLES.search(above) else ""
    length = ""
    if match := _LENGTHS.search(above):
        length = unit_of(f"x [{match[1]}]") or ""
        if length not in units_of("x"):
            raise InputError(f"{source}: its lengths are in {match[1]}; export it in meters or millimeters")
    with_units = []
    for name in names:
        unit = turned if "rotation" in name.lower() else length
        coordinate = re.search(r"(?:^|[/ ])[XYZ]$", name) is not None
        with_units.append(f"{name} [{unit}]" if unit and coordinate else name)
    return with_units


def _unique(names: Iterable[str], notes: list[str]) -> tuple[str, ...]:
    """Names of which none is empty, and none stands there twice but those that a recording may have once."""
    unique: list[str] = []
    counts: Counter[str] = Counter()
    for k, name in enumerate(names):
        name = name or f"column_{k + 1}"
        counts[name] += 1
        unique.append(name if counts[name] == 1 or is_standard(name) else f"{name} ({counts[name]})")
    if twice := [name for name in counts if counts[name] > 1 and not is_standard(name)]:
        shown = ", ".join(repr(name[:40]) for name in twice[:3])
        notes.append(f"several columns are called {shown}: the later ones are read as '{twice[0][:40]} (2)' and so on")
    return tuple(unique)


def _decimal(rows: Iterable[Row], delimiter: str) -> str:
    """A comma where more numbers have one than a point, whatever stands in texts and dates."""
    cells = [part for row in rows for cell in row for part in cell.split(_ELEMENT)] if delimiter != "," else []
    commas, points = (
        sum(re.fullmatch(rf"[-+]?\d*{mark}\d+(e[-+]?\d+)?", cell, re.IGNORECASE) is not None for cell in cells)
        for mark in (",", r"\.")
    )
    return "," if commas > points else "."


def _of_names_alone(lines: Sequence[str]) -> Layout:
    """The first line with anything as names: of a table without rows, or with rows of text alone."""
    first = next(k for k, line in enumerate(lines) if line.strip())
    delimiter = max(_DELIMITERS[:-1], key=lambda mark: lines[first].count(mark))
    names = _unique(_split(lines[first], delimiter), [])
    return Layout(names, delimiter, len(names), ".", first + 1, False, False)


def _say_above(lines: Sequence[str], notes: list[str]) -> None:
    filled = [k for k, line in enumerate(lines) if line.strip(" \t,;|") and not line.lower().startswith("sep=")]
    if filled:
        excerpt = " ".join(lines[filled[0]].split())
        excerpt = excerpt if len(excerpt) <= 60 else f"{excerpt[:57]}..."
        place = f"line {filled[0] + 1} stands" if len(filled) == 1 else f"{len(filled)} lines stand"
        notes.append(f"{place} above the table and {'is' if len(filled) == 1 else 'are'} not read: {excerpt!r}")


# ------------------------------------------------------------------ the numbers


HEADER_LIMIT = 1 << 20
_LATIN = {*b"\xb0\xb1\xb2\xb3\xb5\xb7", *range(0xC0, 0xD7), *range(0xD9, 0xF7), *range(0xF9, 0x100)}
"""Bytes that are °, ±, ², ³, µ, · and letters in Latin-1, and are rare in text of other encodings."""
_MARKUP = re.compile(r"\s*(\{|<[?!\w][^,;\t\r\n]*>\s*$)", re.MULTILINE)


class _NoNumberError(InputError):
    """A field that holds no number but a text, in the column of this index."""

    def __init__(self, message: str, index: int, text: str) -> None:
        super().__init__(message)
        self.index = index
        self.text = text


def open_text(path: Path, notes: list[str], growing: bool = False, content: bytes | None = None) -> RawTable:
    """The table in a file of text.

    Args:
        path: the file; UTF-8, UTF-16 with its mark, or Latin-1 where it can be nothing else.
        notes: gets a sentence on what stands above the table, on what was done to its names, and one where the last
            line has no end.
        growing: whether it is of a recording that was not completed. A kill may leave a part of a row at its end, and
            a power cut zeros. They are left out, and a note says so.
        content: the text itself, where it was made of the file.

    Raises:
        InputError: no text; from `load`, rows of another length than the names.
    """
    complete_lines = _whole_lines(path, notes) if growing else content
    with open(path, "rb") if complete_lines is None else io.BytesIO(complete_lines) as file:
        start, encoding = _start(path, file.read(HEADER_LIMIT), notes)
        if holds_pairs("\n".join(LINE_BREAK.split(start, LINES)[:LINES])):
            return _open_pairs(path.read_bytes().decode(encoding, "replace"), notes)
        file.seek(0, 2)
        file.seek(max(0, file.tell() - HEADER_LIMIT))
        tail = file.read()
    layout = find_table(start, str(path), notes)
    if not tail.rstrip(b"\0").endswith((b"\n", b"\r")):
        notes.append("the file does not end with a line break: its last number may have been cut short")
    plain = complete_lines is None and encoding == "utf-8-sig" and layout.delimiter != SPACES and not layout.lists
    rewritten = cache(
        lambda: _rewritten(path.read_bytes() if complete_lines is None else complete_lines, layout, encoding)
    )

    @cache
    def filled() -> bytes:
        notes.append("lists have fewer elements in some rows, which are read as missing there")
        return _filled(rewritten(), layout)

    def load(columns: Mapping[int, str]) -> dict[int, Values]:
        indices = [*columns]
        wrong = {}
        texts = {index for index, quantity in columns.items() if quantity in LABELS}
        ragged = False
        while True:
            try:
                content = filled() if ragged else None if plain else rewritten()
                table = _read(path, layout, indices, content, texts)
                break
            except _RaggedError as error:
                widths = _widths(rewritten(), layout)
                short = {width for width in widths if width != layout.fields}
                cut = error.row == len(widths)
                if cut or any(width > layout.fields or not _ends_a_list(layout.names, width) for width in short):
                    raise InputError(f"{path}: {_describe_shape(error.row, error.fields, widths, layout)}") from error
                ragged = True
            except _NoNumberError as error:
                if columns[error.index] == "time" and like_a_clock(error.text):
                    texts.add(error.index)
                    continue
                wrong[error.index] = str(error)  # the others may hold numbers
                indices.remove(error.index)
        return {index: wrong.get(index) or table[str(index)] for index in columns}

    return RawTable(layout.names, load, layout.nameless)


def _widths(content: bytes, layout: Layout) -> list[int]:
    """The number of fields of each row."""
    return [len(_split(line, layout.delimiter)) for line in content.decode("utf-8", "replace").splitlines() if line]


def _filled(content: bytes, layout: Layout) -> bytes:
    """The rows with empty fields for what lists lack at their end."""
    lines = [line for line in content.decode("utf-8", "replace").splitlines() if line]
    missing = (layout.fields - width for width in _widths(content, layout))
    return "\n".join(line + layout.delimiter * count for line, count in zip(lines, missing, strict=True)).encode()


def _open_pairs(text: str, notes: list[str]) -> RawTable:
    """The table of a log of pairs."""
    pairs = read_pairs(text)
    rows = len(next(iter(pairs.columns.values())))
    repeated = f", of which some hold several readings: {rows} rows" if rows != pairs.blocks else ""
    notes.append(f"the file holds no table but KEY=VALUE pairs, in {pairs.blocks} blocks{repeated}; keys are columns")
    if pairs.single:
        shown = ", ".join(pairs.single[:6]) + (", …" if len(pairs.single) > 6 else "")
        notes.append(f"keys that stand there once are not read: {shown}")
    return RawTable.of_arrays(pairs.columns)


class _RaggedError(Exception):
    """A row with another number of fields than there are names."""

    def __init__(self, row: int, fields: int) -> None:
        super().__init__(row, fields)
        self.row = row
        self.fields = fields


def _whole_lines(path: Path, notes: list[str]) -> bytes | None:
    """What is in a file without what stands behind its last line break; None where nothing does."""
    content = path.read_bytes()
    end = content.rfind(b"\n") + 1
    if end == len(content):
        return None
    remainder = "a row that was cut" if content[end:].strip(b"\0") else "zeros"
    notes.append(f"the recording was ended while it was written: {remainder} at the end of {path.name} is left out")
    return content[:end]


def _rewritten(content: bytes, layout: Layout, encoding: str) -> bytes:
    """The rows of numbers as Arrow can read them: UTF-8, one delimiter between numbers, none of them in lists."""
    text = content.decode(encoding, "replace")
    text = "\n".join(LINE_BREAK.split(text, maxsplit=layout.skip)[layout.skip :])
    if layout.lists:
        text = mark_lists(text, layout.delimiter)
    if layout.delimiter == SPACES:
        text = re.sub(r"^ | (?=[\r\n]|\Z)", "", re.sub(r"[ \t]+", SPACES, text), flags=re.MULTILINE)
    return text.encode()


def _read(
    path: Path,
    layout: Layout,
    indices: Sequence[int],
    content: bytes | None,
    texts: Set[int],
    threads: bool = True,
) -> pa.Table:
    """The columns wanted, named by their index: two ignored columns may share a name. Those of `texts` are of text.

    `content` has the rows below the names; None where those of the file are read as they are.
    """
    if not indices:
        return pa.table({})
    included = [str(index) for index in indices]
    kinds = {str(index): pa.string() if index in texts else pa.float64() for index in indices}
    numbers = [str(index) for index in range(layout.fields)]
    skip = layout.skip if content is None else 0
    try:
        return pa_csv.read_csv(
            path if content is None else pa.py_buffer(content),
            pa_csv.ReadOptions(column_names=numbers, skip_rows=skip, use_threads=threads),
            pa_csv.ParseOptions(delimiter=layout.delimiter),
            pa_csv.ConvertOptions(
                include_columns=included,
                column_types=kinds,
                decimal_point=layout.decimal,
            ),
        )
    except pa.ArrowInvalid as error:
        if "Could not skip" in str(error) or "Empty CSV" in str(error):  # Arrow's words for names and nothing below
            raise InputError(f"{path}: has column names but no rows; record again") from error
        if threads:  # rows are numbered only when they are read in order
            return _read(path, layout, indices, content, texts, threads=False)
        if match := re.search(r"Row #(\d+): Expected \d+ columns, got (\d+)", str(error)):
            raise _RaggedError(int(match[1]) - skip, int(match[2])) from error
        if match := re.match(r"In CSV column #(\d+): Row #(\d+): .*?invalid value '(.*)'$", str(error), re.DOTALL):
            raise _no_number(int(match[2]) - skip, int(match[1]), match[3], layout) from error
        raise InputError(f"{path}: is not a table of numbers ({one_line(error)}); check the file") from error


def _no_number(row: int, index: int, text: str, layout: Layout) -> _NoNumberError:
    if text.strip() and text.strip() == layout.names[index]:
        problem = f"row {row} repeats the names of the columns; remove it, and give each recording a file"
    else:
        shown = repr(text if len(text) <= 40 else f"{text[:37]}...")
        problem = (
            f"row {row} holds {shown}, which is no number; give numbers with a decimal "
            f"{'point' if layout.decimal == '.' else 'comma'}, and leave missing ones empty"
        )
    return _NoNumberError(problem, index, text)


def _describe_shape(row: int, fields: int, widths: Sequence[int], layout: Layout) -> str:
    """What is seen of rows that have another number of fields than there are names, and what helps."""
    place = f"row {row} has {fields} of {layout.fields} columns"
    odd_widths = [width for width in widths if width != layout.fields]
    shapes = ", ".join(f"{count} have {width}" for width, count in sorted(Counter(widths).items()))
    evidence = f"of {len(widths)} rows {shapes} fields, and there are {layout.fields} names"
    if fields == 2 * layout.fields:
        return (
            f"{place}, twice as many, as where decimal commas separate fields too; write decimals with a point, or "
            "separate fields by another mark"
        )
    if fields > layout.fields:
        remedy = (
            "name each column"
            if len(odd_widths) == len(widths)
            else "remove the surplus fields, or put texts in quotes"
        )
        return f"{place}: {evidence}; {remedy}"
    place = f"{place}, {layout.names[min(fields, len(layout.names) - 1)]} is the first without a value"
    if len(odd_widths) > 1:
        return f"{place}: {evidence}; complete the rows or remove them"
    problem = "the file is truncated" if row == len(widths) else "the row is cut short"
    return f"{place}: {problem}; complete the row or remove it"


def _start(path: Path, start: bytes, notes: list[str]) -> tuple[str, str]:
    """The first whole lines of a text by its first bytes, and its encoding."""
    if start.startswith(b"PAR1"):
        raise InputError(f"{path}: is a Parquet file, whatever its name says; name it .parquet")
    text, encoding = _decode(start)
    text = text if len(start) < HEADER_LIMIT else text[: max(text.rfind("\n"), text.rfind("\r")) + 1]
    if "\0" in text or not (text or len(start) < HEADER_LIMIT):
        raise InputError(f"{path}: is not a CSV table but binary or of another encoding; write it as UTF-8 text")
    if not text.strip():
        raise InputError(f"{path}: is empty; record again")
    if markup := _MARKUP.match(text):
        kind = "JSON" if markup[1] == "{" else "a page or XML"
        raise InputError(f"{path}: is {kind}, and no table; write its numbers as CSV with a name for each column")
    if encoding != "utf-8-sig":
        notes.append(f"the text is read as {encoding.capitalize() if encoding == 'latin-1' else encoding.upper()}")
    return text, encoding


def _decode(start: bytes) -> tuple[str, str]:
    """The text that bytes are, and its encoding; a zero where they are of no text, or may have several meanings."""
    marked = start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "latin-1"):
        with suppress(UnicodeDecodeError):
            text = codecs.getincrementaldecoder(encoding)().decode(start)
            if encoding != "latin-1" or {byte for byte in start if byte > 0x7F} <= _LATIN:
                return text, encoding
    return "\0", ""
