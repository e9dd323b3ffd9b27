"""Tables of text: found in their file, whatever stands above them, and read by Arrow."""

import codecs
import re
from collections.abc import Mapping, Sequence, Set
from functools import cache
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pa_csv

from lite6jax.errors import InputError
from lite6jax.recordings.clock_times import like_a_clock
from lite6jax.recordings.columns import LABELS, Column
from lite6jax.recordings.layout import LINE_BREAK, SPACES, Layout, find_table, mark_lists
from lite6jax.recordings.raw import RawTable, one_line
from lite6jax.recordings.table import Loaded

HEADER_LIMIT = 1 << 20
_LATIN = {*b"\xb0\xb1\xb2\xb3\xb5\xb7", *range(0xC0, 0xD7), *range(0xD9, 0xF7), *range(0xF9, 0x100)}
"""Bytes that are °, ±, ², ³, µ, · and letters in Latin-1, and are rare in text of other encodings."""
_MARKUP = re.compile(r"\s*(\{|<[?!\w][^,;\t\r\n]*>\s*$)", re.MULTILINE)
_THOUSANDS = re.compile(r"[-+]?\d{1,3}([.,' ]\d{3})+([.,]\d*)?")


class _NoNumberError(InputError):
    """A field that holds no number but a text, in the column of this index."""

    def __init__(self, message: str, index: int, text: str) -> None:
        super().__init__(message)
        self.index, self.text = index, text


def of_csv(path: Path, notes: list[str]) -> RawTable:
    """The table in a file of text.

    Args:
        path: the file; UTF-8, UTF-16 with its mark, or Latin-1 where it can be nothing else.
        notes: gets a sentence on what stands above the table, on what was done to its names, and one where the last
            line has no end.

    Raises:
        InputError: no text; from `load`, rows of another length than the names.
    """
    start, encoding = _start(path, notes)
    layout = find_table(start, str(path), notes)
    with open(path, "rb") as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - HEADER_LIMIT))
        tail = file.read()
    if not tail.rstrip(b"\0").endswith((b"\n", b"\r")):
        notes.append("the file does not end with a line break: its last number may have been cut short")
    plain = encoding == "utf-8-sig" and layout.delimiter != SPACES and not layout.lists
    rewritten = cache(lambda: _rewritten(path, layout, encoding))

    def load(columns: Mapping[str, Column]) -> Loaded:
        wanted, wrong = [column.index for column in columns.values()], {}
        times = {column.index for column in columns.values() if column.quantity == "time"}
        texts = {column.index for column in columns.values() if column.quantity in LABELS}
        while True:
            try:
                table = _read(path, layout, wanted, tail if plain else rewritten(), texts, plain)
                break
            except _NoNumberError as error:
                if error.index in times and like_a_clock(error.text):
                    texts.add(error.index)
                    continue
                wrong[error.index] = str(error)  # the others may hold numbers
                wanted.remove(error.index)
        return {key: wrong.get(column.index) or table[str(column.index)] for key, column in columns.items()}

    return RawTable(layout.names, load, layout.nameless)


def _rewritten(path: Path, layout: Layout, encoding: str) -> bytes:
    """The rows of numbers as Arrow can read them: UTF-8, one delimiter between numbers, none of them in lists."""
    with open(path, "rb") as file:
        text = file.read().decode(encoding, "replace")
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
    content: bytes,
    texts: Set[int],
    plain: bool,
    threads: bool = True,
) -> pa.Table:
    """The columns wanted, named by their index: two ignored columns may share a name. Those of `texts` are of text.

    `content` is the end of the file where that is plain, else all of its rows, rewritten.
    """
    if not indices:
        return pa.table({})
    wanted = [str(index) for index in indices]
    kinds = {str(index): pa.string() if index in texts else pa.float64() for index in indices}
    numbers = [str(index) for index in range(layout.fields)]
    skip = layout.skip if plain else 0
    try:
        return pa_csv.read_csv(
            path if plain else pa.py_buffer(content),
            pa_csv.ReadOptions(column_names=numbers, skip_rows=skip, use_threads=threads),
            pa_csv.ParseOptions(delimiter=layout.delimiter),
            pa_csv.ConvertOptions(
                include_columns=wanted,
                column_types=kinds,
                decimal_point=layout.decimal,
            ),
        )
    except pa.ArrowInvalid as error:
        if "Could not skip" in str(error) or "Empty CSV" in str(error):  # Arrow's words for names and nothing below
            raise InputError(f"{path}: has column names but no rows; record again") from error
        if threads:  # rows are numbered only when they are read in order
            return _read(path, layout, indices, content, texts, plain, threads=False)
        if match := re.search(r"Row #(\d+): Expected \d+ columns, got (\d+)", str(error)):
            raise InputError(_ragged(path, int(match[1]) - skip, int(match[2]), layout, content)) from error
        if match := re.match(r"In CSV column #(\d+): Row #(\d+): .*?invalid value '(.*)'$", str(error), re.DOTALL):
            raise _no_number(int(match[2]) - skip, int(match[1]), match[3], layout) from error
        raise InputError(f"{path}: is not a table of numbers ({one_line(error)}); check the file") from error


def _no_number(row: int, index: int, text: str, layout: Layout) -> _NoNumberError:
    shown = repr(text if len(text) <= 40 else f"{text[:37]}...")
    point = "point" if layout.decimal == "." else "comma"
    if text.strip() and text.strip() == layout.names[index]:
        problem = f"row {row} repeats the names of the columns; remove it, and give each recording a file"
    elif _THOUSANDS.fullmatch(text.strip()):
        problem = (
            f"row {row} holds {shown}, which may have a mark of thousands; give numbers with a decimal {point}, and "
            "without marks of thousands"
        )
    else:
        problem = (
            f"row {row} holds {shown}, which is no number; give numbers with a decimal {point}, and leave missing ones "
            "empty"
        )
    return _NoNumberError(problem, index, text)


def _ragged(path: Path, row: int, fields: int, layout: Layout, content: bytes) -> str:
    place = f"{path}: row {row} has {fields} of {layout.fields} columns"
    if fields < layout.fields:
        last = content.rstrip().rpartition(b"\n")[2]
        cut = last.count(layout.delimiter.encode()) + 1 == fields
        problem = "the file is truncated" if cut else "the row is cut short"
        first = layout.names[min(fields, len(layout.names) - 1)]
        return f"{place}, {first} is the first without a value: {problem}; complete the row or remove it"
    return f"{place}; remove the surplus fields, and write decimals with a point"


def _start(path: Path, notes: list[str]) -> tuple[str, str]:
    """The first whole lines of a text, and its encoding."""
    with open(path, "rb") as file:
        start = file.read(HEADER_LIMIT)
    if not start.strip():
        raise InputError(f"{path}: is empty; record again")
    if start.startswith(b"PAR1"):
        raise InputError(f"{path}: is a Parquet file, whatever its name says; name it .parquet")
    encoding = _encoding(start)
    text = "\0"
    if encoding:
        text = codecs.getincrementaldecoder(encoding)().decode(start)
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


def _encoding(start: bytes) -> str:
    """What bytes are decoded by; empty where they are of no text, or of text that may have several meanings."""
    marked = start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ["utf-16"] if marked else ["utf-8-sig"]:
        try:
            codecs.getincrementaldecoder(encoding)().decode(start)
            return encoding
        except UnicodeDecodeError:
            pass
    return "latin-1" if not marked and {byte for byte in start if byte > 0x7F} <= _LATIN else ""
