"""The canonical form of what was asked for: the same for equal values in any process, another for any other value."""

import subprocess
import sys
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pytest

from benchmarks.concealed.campaign import POSES
from benchmarks.torque_trials.campaign import TORQUES
from lite6jax.arms.bundled import load_bundled
from lite6jax.cli.diagnose import Diagnose
from lite6jax.distribution.canonical import canonical
from lite6jax.folders.place import Place


class Colour(Enum):
    RED = 1
    GREEN = 2


class Pair(NamedTuple):
    a: int
    b: int


@dataclass(frozen=True)
class Point:
    x: float
    y: float


def other():
    pass


DIFFERENT = [
    None,
    *(True, 1, 1.0, "1", b"1", Path("1"), -0.0, 0.0, 0, "", float("nan"), float("inf"), np.nextafter(1, 2).item()),
    *((), [], {}, set(), (1,), [1], {1: 2}, {"1": 2}, {1}, ((1,),), (1, 2), Pair(1, 2), (2, 1), [1, [2]], [[1], 2]),
    *(Colour.RED, Colour.GREEN, Point(1, 2), Point(2, 1), Point(1.0, 2.0), Point, Pair, other, len),
    *(np.zeros(2), np.zeros((2, 1)), np.zeros(2, int), np.zeros(2, np.float32), np.array([0.0, -0.0]), np.float64(1)),
    *(pa.schema({"a": pa.int32()}), pa.schema({"a": pa.int64()}), pa.schema({"b": pa.int64()})),
    *(load_bundled("lite6"), load_bundled("ur10"), replace(load_bundled("lite6"), name="mine"), Place.of(".")),
    *(Diagnose(Path("a")), Diagnose(Path("b")), Diagnose(Path("a"), force=True), POSES, TORQUES),
]


def test_different_values_have_different_forms():
    forms = [canonical(value) for value in DIFFERENT]
    alike = [(DIFFERENT[i], DIFFERENT[j]) for i, form in enumerate(forms) for j in range(i) if forms[j] == form]
    assert alike == []


def test_equal_values_have_equal_forms_whatever_their_order_in_memory_and_their_layout():
    assert canonical({"a": 1, "b": 2}) == canonical({"b": 2, "a": 1})
    assert canonical({3, 1, 2}) == canonical({1, 2, 3})
    array = np.arange(6.0).reshape(2, 3)
    assert canonical(array) == canonical(np.asfortranarray(array)) == canonical(np.repeat(array, 2, 1)[:, ::2])
    text = "ab" * 10
    shared, apart = (text, text), ("ab" * 10, "".join(["ab"] * 10))  # a pickle of these differs
    assert canonical(shared) == canonical(apart)


def test_another_process_makes_the_same_form():
    code = """
import sys
from pathlib import Path
from lite6jax.arms.bundled import load_bundled
from lite6jax.distribution.canonical import canonical
sys.stdout.write(canonical((load_bundled("lite6"), {"x", "y", "z"}, Path("a"), 0.1, Path)).hex())
"""
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert bytes.fromhex(said) == canonical((load_bundled("lite6"), {"z", "y", "x"}, Path("a"), 0.1, Path))


@pytest.mark.parametrize(
    "value", [object(), lambda: 0, np.array([object()]), (1, iter([]))], ids=["object", "function", "array", "iterator"]
)
def test_what_has_no_canonical_form_is_refused(value):
    with pytest.raises(TypeError, match="has no canonical form"):
        canonical(value)
