"""Commands on files that once hung or crashed them, or that they would have lost: one line, exit code 2, all
kept; and every reader on damaged ones."""

import os
import shutil
import signal

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typed import refused

from lite6jax.arms.files import write_arm, write_table
from lite6jax.recordings import Recording, write_recording
from tests.damaged import CSV, FACTORY, LITE6, READERS, Trial, damage, recording


@pytest.fixture(autouse=True)
def _deadline():
    """Ends the process where a command waits for ever."""
    signal.alarm(300)
    yield
    signal.alarm(0)


@pytest.fixture
def recorded(tmp_path):
    return CSV.write(tmp_path)


# ------------------------------------------------------------------ what is no file


@pytest.mark.parametrize("command", ["fit", "check", "identify", "diagnose", "fleet"])
@pytest.mark.parametrize("name", ["pipe.csv", "pipe.parquet", "pipe.yaml", "pipe.json"])
def test_a_pipe_is_refused_at_once(capsys, tmp_path, command, name):
    pipe = tmp_path / "folder" / name
    pipe.parent.mkdir()
    os.mkfifo(pipe)
    source, out = (pipe.parent, tmp_path / "out.parquet") if command == "fleet" else (pipe, tmp_path / "out.json")
    options = ["--out", out] if command in ("fleet", "diagnose") else []
    message = refused(capsys, command, source, *options)
    assert "has no calibration or recording" in message if command == "fleet" else "is a pipe; write its" in message


def test_names_that_are_not_utf8_or_too_long(capsys, recorded, tmp_path):
    name = tmp_path / os.fsdecode(b"\xff\xfe.csv")
    shutil.copy(recorded, name)
    for command in ("fit", "check", "identify"):
        assert refused(capsys, command, name).endswith("its name is not UTF-8; rename the file or its folder")
    long = tmp_path / ("x" * 300)
    for suffix in (".csv", ".parquet", ".yaml", ".json", ".urdf", ".mcap"):
        assert refused(capsys, "identify", f"{long}{suffix}").endswith(
            "cannot be read (File name too long); check the name"
        )
    assert "neither a bundled arm nor a file" in refused(capsys, "identify", "x" * 300)
    assert refused(capsys, "fit", recorded, "--out", f"{long}.json").endswith(
        "(File name too long); choose another name"
    )
    assert refused(capsys, "fleet", long, "--out", tmp_path / "f.parquet").endswith("no such folder; name one")
    assert "File name too long" in refused(capsys, "simulate", "lite6", "--out", tmp_path / ("s" * 251 + ".csv"))


# ------------------------------------------------------------------ what would be lost


def commands_that_replace_their_input(folder):
    """Arguments, and the file that is both read and written."""
    recorded = CSV.write(folder)
    sidecar = recorded.with_suffix(".yaml")
    arm = write_arm(LITE6, folder / "mine.yaml")
    factory = FACTORY.write(folder)
    table = write_table(LITE6.form, LITE6.hayati, folder / "table.json")
    yield ["fit", table, "--out", table], table
    yield ["fit", factory, "--arm", table, "--out", table], table
    yield ["convert", factory, factory], factory
    yield ["convert", arm, sidecar.parent / "." / "mine.yaml"], arm
    yield ["simulate", arm, "--out", folder / "mine.csv"], arm
    yield ["simulate", "lite6", "--factory", factory, "--out", folder / "arm.csv"], factory
    yield ["design", arm, "--out", folder / "mine.csv", "--poses", "3"], arm
    yield ["design", "lite6", "--recorded", recorded, "--out", folder / "run7.parquet", "--poses", "3"], sidecar
    yield ["diagnose", recorded, "--arm", table, "--out", table], table
    yield ["predict", table, recorded, "--out", recorded], recorded
    yield ["compensate", table, recorded, "--out", recorded], recorded
    yield ["fleet", folder, "--out", write_recording(recording(), folder / "last.parquet")], folder / "last.parquet"
    yield ["record", "--ip", "127.0.0.1", "--poses", recorded, "--out", recorded], recorded
    yield ["read", "--ip", "127.0.0.1", "--arm", arm, "--out", arm], arm


def test_no_command_replaces_what_it_reads(capsys, tmp_path):
    for arguments, file in commands_that_replace_their_input(tmp_path):
        before = file.read_bytes()
        message = refused(capsys, *arguments, "--force")
        assert "would be replaced; choose another name" in message, arguments
        assert message.startswith(str(file)), arguments
        assert file.read_bytes() == before


def test_files_that_a_sidecar_names_are_inputs_too(capsys, tmp_path):
    table = write_table(LITE6.form, LITE6.hayati, tmp_path / "own.json")
    path = write_recording(Recording.from_arrays([[0.0] * 6], factory_calibration="own.json"), tmp_path / "run7.csv")
    assert refused(capsys, "fit", path, "--out", table, "--force").startswith(f"{table}: is read by this command")
    assert refused(capsys, "diagnose", path, "--out", table, "--force").startswith(f"{table}: is read by this command")


# ------------------------------------------------------------------ what is damaged


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
