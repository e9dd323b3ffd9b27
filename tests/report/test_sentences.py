"""Where sentences stand: conditions in functions, which a type checker reads, and each sentence once."""

import re
from pathlib import Path

import pytest

import lite6jax.report
from lite6jax.report.sentences.faults import CLAUSES, FOUND, NAMES, RULED_OUT

TEMPLATES = sorted((Path(lite6jax.report.__file__).parent / "templates").glob("*.yaml"))


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: path.name)
def test_texts_have_no_conditions(path):
    text = path.read_text()
    assert "{%" not in text
    assert [place for place in re.findall(r"{{.*?}}", text, re.DOTALL) if re.search(r"\bif\b", place)] == []


@pytest.mark.parametrize(("key", "functions"), [("found", FOUND), ("ruled_out", RULED_OUT), ("clause", CLAUSES)])
def test_each_sentence_of_a_fault_stands_once(key, functions):
    assert functions.keys() <= NAMES.keys()
    assert [code for code in functions if key in NAMES[code]] == []
