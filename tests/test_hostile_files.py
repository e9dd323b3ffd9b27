"""Commands on files that once hung or crashed them, or that they would have lost: one line, exit code 2, all kept."""

import os
import shutil
import signal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typed import flat, refused, run

from lite6jax.arms.files import write_arm, write_table
from lite6jax.cli.command import check_outputs
from lite6jax.errors import InputError
from lite6jax.fleet.folder import fit_folder, tabulate_rows
from lite6jax.fleet.place import Place, list_fleet
from lite6jax.recordings import Recording, RecordingSettings, write_recording, write_settings
from lite6jax.workers import write_tables
from tests.damaged import CSV, FACTORY, LITE6, recording


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


def test_devices_are_neither_read_nor_replaced(capsys, recorded, tmp_path):
    assert refused(capsys, "fit", "/dev/zero").startswith("/dev/zero: is a device; write its content to a file first")
    target = tmp_path / "model.json"
    target.symlink_to("/dev/null")
    assert "is a device, which a file would replace" in refused(capsys, "fit", recorded, "--out", target, "--force")
    assert target.is_symlink()


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


def test_a_fleet_survives_a_name_that_is_not_utf8(tmp_path):
    folder = tmp_path / "fleet"
    folder.mkdir()
    shutil.copy(FACTORY.write(tmp_path), folder / os.fsdecode(b"\xff.yaml"))
    os.mkfifo(folder / "pipe.csv")
    path = fit_folder(folder, tmp_path / "fleet.parquet", processes=0)
    (row,) = pq.read_table(path).to_pylist()
    assert row["file"] == "\\udcff.yaml"
    assert row["message"].endswith("its name is not UTF-8; rename the file or its folder")


def test_text_that_is_not_utf8(capsys, recorded, tmp_path):
    table = tmp_path / "names.parquet"
    pq.write_table(pa.table({"q1_rad": [1.0], "zz": [2.0]}), table)
    table.write_bytes(table.read_bytes().replace(b"zz", b"\xff\xfe"))
    assert refused(capsys, "fit", table).endswith("a column name is not UTF-8; write the file again with other names")
    ragged = tmp_path / "ragged.csv"
    ragged.write_bytes(b"q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad\n1,2,3,4,5,6\n1,\xff2\n1,2,3,4,5,6\n")
    message = "row 2 has 2 of 6 columns, q3_rad is the first without a value: the row is cut short; complete the row or"
    assert message in refused(capsys, "fit", ragged, "--arm", "lite6")


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


def test_inputs_of_a_log_and_of_a_growing_recording_are_those_of_its_sidecar(tmp_path):
    sidecar = tmp_path / "run7.yaml"
    write_settings(RecordingSettings(arm="mine.urdf"), sidecar)
    arm = tmp_path / "mine.urdf"
    arm.write_text("<robot/>")
    for source in ("run7.arrows", "run7.ARROWS", "run7.mcap#/joint_states"):
        for output in (sidecar, arm):
            with pytest.raises(InputError, match="is read by this command and would be replaced"):
                check_outputs([output], [str(tmp_path / source)], True)
    check_outputs([sidecar, arm], [tmp_path / "run7.doc"], True)


def test_the_table_of_an_earlier_fleet_is_replaced(tmp_path):
    FACTORY.write(tmp_path)
    out = write_tables([tabulate_rows([])], tmp_path / "fleet.parquet")
    assert list_fleet(Place.of(tmp_path), out) == ["arm.yaml"]


# ------------------------------------------------------------------ what crashed on numbers


def test_a_joint_far_outside_is_dropped_and_no_angle_is_infinite(capsys, recorded):
    lines = [line.split(",") for line in recorded.read_text().splitlines()]
    lines[7][lines[0].index("q2_rad")] = "1e308"
    recorded.write_text("".join(",".join(line) + "\n" for line in lines))
    recorded.with_suffix(".yaml").write_text("recording: {pose_frame: base, tool: none, motion: static}\n")
    code, said, _ = run(capsys, "check", recorded, width=300)
    assert code == 0
    assert "numbers beyond any arm or sensor count as missing: 1e+308 in column q2_rad, row 7" in flat(said)
    assert "inf°" not in said


def test_a_recording_without_missing_numbers_is_required():
    from lite6jax import InputError, fit, identify, identify_recording, plan_experiment

    whole = recording()

    def with_joints(joint_position):
        from dataclasses import replace

        return replace(whole, joint_position=joint_position)

    gap = whole.joint_position.copy()
    gap[3, 1] = np.nan
    for call in (fit, identify_recording):
        with pytest.raises(InputError, match="row 4 has nan in column q2_rad; leave such rows out with drop_missing"):
            call(with_joints(gap))
        with pytest.raises(InputError, match="column q1_rad holds complex numbers; give real ones"):
            call(with_joints(whole.joint_position + 1j))
        with pytest.raises(InputError, match="are these degrees"):
            call(with_joints(np.rad2deg(whole.joint_position)))
    with pytest.raises(InputError, match="joint_position: holds complex numbers; give real ones"):
        Recording.assembled(whole.joint_position + 1j)
    experiment = plan_experiment("lite6")
    for wrong, message in (
        (np.rad2deg(whole.joint_position), r"are these degrees\? give radians: np\.deg2rad\(joint_position\)"),
        (whole.joint_position + 1j, "joint_position: holds complex numbers; give real ones"),
        (gap, "joint_position: row 4 is not finite; leave it out"),
    ):
        with pytest.raises(InputError, match=message):
            identify(experiment, wrong)
