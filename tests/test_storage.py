"""Files as they should not be: pipes, devices, names, file systems without links, YAML that would end the process."""

import errno
import os
import signal
from contextlib import suppress

import hypothesis
import pytest
import yaml
from hypothesis import strategies as st
from typed import refusal

from lite6jax import storage
from lite6jax.errors import InputError


@pytest.fixture
def deadline():
    """Ends the process where something waits for ever."""
    signal.alarm(60)
    yield
    signal.alarm(0)


@pytest.mark.usefixtures("deadline")
def test_pipes_and_devices_are_neither_read_nor_replaced(tmp_path):
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    assert refusal(storage.read_yaml, pipe).endswith("is a pipe; write its content to a file first, and name that")
    assert "/dev/zero: is a device" in refusal(storage.read_text, "/dev/zero", 10)
    assert "is a pipe, which a file would replace" in refusal(storage.write_atomically, pipe, "text", True)
    assert "is a device, which a file would replace" in refusal(storage.check_writable, "/dev/null", True)
    assert "is a folder; name a file" in refusal(storage.read_text, tmp_path, 10)
    assert "no such file" in refusal(storage.read_text, pipe / "below", 10)


@pytest.mark.parametrize("code", [errno.EPERM, errno.EOPNOTSUPP])
def test_writing_needs_no_hard_links(tmp_path, monkeypatch, code):
    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr("pathlib.Path.chmod", lambda *_: (_ for _ in ()).throw(PermissionError(errno.EPERM, "mode")))
    path = storage.write_atomically(tmp_path / "new.txt", "mine")
    assert path.read_text() == "mine"

    def appear(target):
        (tmp_path / "late.txt").write_text("theirs")
        target.write_text("mine")

    assert "appeared while it was being written" in refusal(storage.write_atomically, tmp_path / "late.txt", appear)
    assert (tmp_path / "late.txt").read_text() == "theirs"
    assert sorted(os.listdir(tmp_path)) == ["late.txt", "new.txt"]


@pytest.mark.parametrize("loader", ["CSafeLoader", "SafeLoader"])
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 30_000, "line 1: nested more than 32 levels deep"),
        ("{a: " * 30_000, "line 1: nested more than 32 levels deep"),
        ("- " * 30_000, "line 1: nested more than 32 levels deep"),
        ("\n".join(" " * k + "a:" for k in range(200)), "line 33: nested more than 32 levels deep"),
        ("a: 1\nb: " + "x" * 20_000, "line 2: a value of over 10000 characters"),
        ("a: " + "1:" * 3000 + "0.5", "not valid YAML (nested too deeply or a malformed value)"),
        ("&a [*a]", "line 1: not valid YAML (found undefined alias 'a')"),
    ],
    ids=range(7),
)
def test_yaml_that_would_end_the_process(tmp_path, monkeypatch, loader, text, message):
    monkeypatch.setattr(storage, "YAML_LOADER", getattr(storage.yaml, loader))
    path = tmp_path / "deep.yaml"
    path.write_text(text)
    assert message in refusal(storage.read_yaml, path)


_NAMES = st.sampled_from(["x", "y", "joint1", "no", "true", "Null", "1", "a b", "kinematics", "_z"])
_NUMBERS = st.one_of(
    st.floats().map(repr),
    st.floats(allow_nan=False).map(lambda value: f"{value:+.3f}"),
    st.integers().map(str),
    st.sampled_from(
        ["007", "0x1f", "1e5", "1.e+5", "1:30", ".5", "-0.0", "~", "text", "'1.0'", "[1]", "1_0.0", "2020-01-02"]
    ),
)
_BLOCKS = st.recursive(
    _NUMBERS, lambda inner: st.lists(st.tuples(_NAMES, inner), min_size=1, max_size=4), max_leaves=12
)


def _lines(block, depth, step):
    for name, inner in block:
        if isinstance(inner, str):
            yield f"{' ' * depth}{name}: {inner}"
        else:
            yield f"{' ' * depth}{name}:"
            yield from _lines(inner, depth + step, step)


@hypothesis.given(_BLOCKS.filter(lambda block: not isinstance(block, str)), st.integers(0, 3), st.data())
@hypothesis.settings(max_examples=200, suppress_health_check=[hypothesis.HealthCheck.function_scoped_fixture])
def test_mappings_are_read_as_yaml_reads_them(tmp_path, block, step, data):
    lines = list(_lines(block, 0, step))
    for _ in range(data.draw(st.integers(0, 2))):
        at = data.draw(st.integers(0, len(lines)))
        lines.insert(
            at, data.draw(st.sampled_from(["# a comment", "", "   ", "  # another", "x: 1.0", "  y: 2.0", "---"]))
        )
    text = data.draw(st.sampled_from(["\n", "\r\n"])).join(lines) + data.draw(st.sampled_from(["", "\n", "  \n"]))
    (tmp_path / "a.yaml").write_text(text)
    with suppress(InputError):  # a name that is there twice, of which YAML takes the last
        assert repr(storage.read_yaml(tmp_path / "a.yaml")) == repr(yaml.safe_load(text))
