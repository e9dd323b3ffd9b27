"""A table and its sidecar as one: what binds them, what reveals damage, and what may be edited by hand."""

import os
import shutil
from pathlib import Path
from random import Random

import numpy as np
import pyarrow.parquet as pq
import pytest

from lite6jax.errors import InputError
from lite6jax.recordings import RecordingSettings, read_recording, read_settings, write_recording, write_settings
from lite6jax.recordings import sidecar as sidecars
from tests.damaged import flip_bit, recording

SUFFIXES = pytest.mark.parametrize("suffix", [".csv", ".parquet"])


def differs(path):
    with pytest.raises(InputError) as caught:
        read_recording(path)
    assert str(caught.value) == (
        f"{path}: is not the table that {path.stem}.yaml was written with (their SHA-256 differ): it is damaged or "
        f"edited, or writing both was interrupted; write both again, or remove the key checksums from {path.stem}.yaml "
        "where they belong together"
    )


@SUFFIXES
@pytest.mark.parametrize("last", ["sidecar", "table"])
def test_a_process_that_is_killed_between_the_two_leaves_a_pair_that_is_refused(tmp_path, suffix, last):
    path = write_recording(recording(), tmp_path / f"run7{suffix}")
    old = {file: file.read_bytes() for file in tmp_path.iterdir()}
    write_recording(recording(50), path, overwrite=True)
    keeps = path if last == "sidecar" else path.with_suffix(".yaml")
    keeps.write_bytes(old[keeps])
    differs(path)
    sidecar = path.with_suffix(".yaml")
    sidecar.write_text("recording:" + sidecar.read_text().partition("recording:")[2])
    assert read_recording(path).samples == (60 if last == "sidecar" else 50)  # as the message says


@SUFFIXES
def test_a_failure_leaves_both_as_they_were(tmp_path, suffix, monkeypatch):
    path = write_recording(recording(), tmp_path / f"run7{suffix}")
    old = {file: file.read_bytes() for file in tmp_path.iterdir()}
    replace, link, done = os.replace, os.link, []

    def once(one):
        def placed(source, target):
            done.append(target)
            if Path(target).suffix == suffix:
                raise OSError(5, "Input/output error")
            one(source, target)

        return placed

    monkeypatch.setattr(os, "replace", once(replace))
    monkeypatch.setattr(os, "link", once(link))
    with pytest.raises(InputError, match="Input/output error"):
        write_recording(recording(50), path, overwrite=True)
    assert [Path(target).suffix for target in done[:2]] == [".yaml", suffix]  # the sidecar was in its place already
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == old
    with pytest.raises(InputError, match="Input/output error"):
        write_recording(recording(50), tmp_path / f"new{suffix}")
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == old


def test_tables_of_both_kinds_may_stand_beside_one_sidecar(tmp_path):
    csv = write_recording(recording(), tmp_path / "run7.csv")
    parquet = write_recording(recording(), tmp_path / "run7.parquet", overwrite=True)
    np.testing.assert_array_equal(read_recording(csv).position, read_recording(parquet).position)


def test_both_may_be_renamed(tmp_path):
    path = write_recording(recording(), tmp_path / "run7.csv")
    shutil.move(path, tmp_path / "other.csv")
    shutil.move(path.with_suffix(".yaml"), tmp_path / "other.yaml")
    assert read_recording(tmp_path / "other.csv").notes == ()


def test_an_edited_sidecar_is_read_with_a_note(tmp_path):
    path = write_recording(recording(), tmp_path / "run7.csv")
    sidecar = path.with_suffix(".yaml")
    text = sidecar.read_text()
    sidecar.write_text("# mine\n" + text)
    assert read_recording(path).notes == ()  # its layout is its reader's
    sidecar.write_text(text.replace("laser_tracker", "camera"))
    read = read_recording(path)
    assert read.settings.pose_source == "camera"
    note = "run7.yaml has been edited since it was written, and is taken as it stands; remove its key checksums where "
    assert read.notes == (f"{note}that is intended",)
    sidecar.write_text(text[: text.index("  tool:")])  # cut off: what is left still says so
    assert read_recording(path).notes[0].startswith("run7.yaml has been edited since it was written")


def test_a_sidecar_without_table_is_bound_to_none(tmp_path):
    path = write_settings(RecordingSettings(arm="ur10"), tmp_path / "run7.yaml")
    assert "csv_sha256" not in path.read_text()
    assert read_settings(path) == RecordingSettings(arm="ur10")


@pytest.mark.parametrize("checksums", ["[]", "3", "{csv: ab}", "{csv_sha256: 3}", "{recording_sha256: null}"])
def test_checksums_that_are_none(tmp_path, checksums):
    path = tmp_path / "run7.yaml"
    path.write_text(f"checksums: {checksums}\nrecording: {{motion: static}}\n")
    with pytest.raises(InputError, match="checksums: holds something else than the SHA-256 of recording_sha256, csv_"):
        sidecars.read_settings(path)


def test_no_flipped_bit_of_a_parquet_file_changes_numbers_in_silence(tmp_path):
    """Without the sidecar's checksum: those of the pages alone."""
    path = write_recording(recording(), tmp_path / "run7.parquet")
    assert pq.ParquetFile(path).metadata.num_rows == 60
    path.with_suffix(".yaml").write_text("recording: {motion: static, pose_frame: base}\n")
    whole, content = read_recording(path), path.read_bytes()
    rng, refused = Random(0), 0
    for _ in range(150):
        path.write_bytes(flip_bit(content, rng))
        try:
            read = read_recording(path)
        except InputError:
            refused += 1
            continue
        for name, column in whole.columns().items():
            assert read.notes != whole.notes or np.array_equal(read.columns()[name], column), name
    assert refused > 75
