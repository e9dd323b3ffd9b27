"""Every reader on damaged files: a value, or one line that says what is wrong."""

from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lite6jax.errors import InputError
from tests.damaged import READERS, Reader, Trial, damage, flip_bit

ACCEPTED = ("read", "refused")


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    made = {}

    def trial(reader):
        if reader.name == "mcap":
            pytest.importorskip("rosbags", reason="the package of the extra `rosbag` is not installed")
        if reader.name not in made:
            made[reader.name] = Trial(reader, tmp_path_factory.mktemp("fuzzed"))
        return made[reader.name]

    return trial


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_a_damaged_file_is_read_or_refused(trials, reader):
    trial = trials(reader)

    @settings(max_examples=25, suppress_health_check=list(HealthCheck))
    @given(st.randoms(use_true_random=False))
    def judge(rng):
        assert trial.judged(damage(trial.content, rng)) in (("read", ""), ("refused", ""))

    judge()


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_any_bytes_are_refused(trials, reader):
    trial = trials(reader)

    @settings(max_examples=15, suppress_health_check=list(HealthCheck))
    @given(st.binary(max_size=200))
    def judge(content):
        assert trial.judged(content)[0] in ACCEPTED

    judge()


def test_damage_is_the_same_for_the_same_seed_and_of_every_kind():
    content = b"q1_rad,x_m\n" + b"0.125,-3.5e-3\n" * 20
    damaged = [damage(content, Random(f"0 {k}")) for k in range(400)]
    assert damaged == [damage(content, Random(f"0 {k}")) for k in range(400)]
    assert len(set(damaged)) > 300
    assert {len(content), len(content) + 1} < {len(one) for one in damaged}
    assert any(b"1e308" in one for one in damaged)
    flipped = flip_bit(content, Random(1))
    assert sum(bin(a ^ b).count("1") for a, b in zip(content, flipped, strict=True)) == 1


def write_number(folder):
    path = folder / "number.txt"
    path.write_text("7")
    return path


def read_badly(path):
    """A reader with every fault, by the length of the file."""
    text = path.read_bytes()
    if len(text) == 2:
        raise InputError(f"{path}: two bytes")
    if len(text) == 3:
        raise InputError("two\nlines")
    if len(text) == 4:
        raise KeyError("four")
    return text


def test_each_outcome_is_what_happened(tmp_path):
    trial = Trial(Reader("bad", write_number, read_badly), tmp_path)
    outcomes = [trial.judged(content)[0] for content in (b"7", b"xx", b"xxx", b"xxxx", b"xxxxx")]
    assert outcomes == ["read", "refused", "traceback", "traceback", "read"]
