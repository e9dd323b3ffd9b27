"""A folder of calibrations and recordings fitted: by path or URL, with the same bytes however it is divided."""

import fsspec
import numpy as np
import pytest

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import read_factory, write_factory
from lite6jax.arms.files import write_table
from lite6jax.calibration.fit import fit_calibration
from lite6jax.calibration.fleet import fit_calibrations
from lite6jax.calibration.quality import Result
from lite6jax.cli import main
from lite6jax.errors import InputError
from lite6jax.fleet import folder, place
from lite6jax.fleet.folder import columns, fit_folder, read_rows
from lite6jax.fleet.place import restore_url
from tests.oracles.arms import perturbed

LITE6 = load_bundled("lite6")


@pytest.fixture
def arms(tmp_path):
    """Five calibrations, one that is none and one that is damaged."""
    folder, rng = tmp_path / "arms", np.random.default_rng(5)
    folder.mkdir()
    for i in range(5):
        write_factory(perturbed(rng, LITE6.kinematics), folder / f"arm{i}.yaml")
    (folder / "broken.yaml").write_text("kinematics: {}\n")
    (folder / "settings.yaml").write_text("ros: {rate: 100}\n")
    return folder


def recording(path):
    names = ",".join([*(f"q{i}_rad" for i in range(1, 7)), "x_m", "y_m", "z_m"])
    path.write_text(f"{names}\n" + "\n".join(",".join(f"{0.1 * k:.3f}" for k in range(i, i + 9)) for i in range(3)))
    return path


def test_processes_and_batches_do_not_change_the_bytes(arms, tmp_path, monkeypatch):
    recording(arms / "run.csv")
    monkeypatch.setattr(place, "BATCH", 3)
    here = fit_folder(arms, tmp_path / "here.parquet", processes=0)
    two = fit_folder(arms, tmp_path / "two.parquet", processes=2)
    assert here.read_bytes() == two.read_bytes()
    rows = {row["file"]: row for row in read_rows(here)}
    assert list(rows) == sorted(rows)
    assert [row["result"] for row in rows.values()].count(Result.CONVERGED) == 5
    assert rows["settings.yaml"]["kind"] == "other"
    assert "kinematics must be a mapping" in rows["broken.yaml"]["message"]
    assert rows["run.csv"]["message"].startswith(str(arms / "run.csv"))


def test_the_closed_form_is_what_a_fit_finds(arms):
    calibrations = [read_factory(arms / f"arm{i}.yaml") for i in range(2)]
    found = fit_calibrations(np.stack([c.kinematics for c in calibrations]), np.stack([np.eye(4)] * 2), LITE6)
    assert found.steps.tolist() == [0, 0]
    for i, calibration in enumerate(calibrations):
        fitted = fit_calibration(calibration)
        np.testing.assert_allclose(found.parameters[i], fitted.parameters, atol=1e-11)
        assert found.errors[i, 1, 1] < 1e-13
        nominal = [fitted.nominal_errors.position.max(), fitted.nominal_errors.orientation.max()]
        np.testing.assert_allclose(found.errors[i, 2, [1, 3]], nominal, rtol=1e-9)


def test_what_the_closed_form_does_not_reproduce_is_fitted(arms):
    parameters = LITE6.hayati + 1e-3 * np.random.default_rng(0).standard_normal(len(LITE6.hayati))
    write_table(LITE6.form, parameters, arms / "table.json")
    (row,) = folder.fit_files([arms / "table.json"], None)
    assert (row["result"], row["quality"]) == (Result.CONVERGED, "good")
    assert row["steps"] > 0
    np.testing.assert_allclose([value for name, value in row.items() if name not in columns()], parameters, atol=1e-9)


def test_a_fleet_may_have_arms_of_any_number_and_kind_of_joints(tmp_path):
    rng, nominal = np.random.default_rng(3), LITE6.kinematics[[0, 1, 3]]
    for i in range(2):
        write_factory(perturbed(rng, nominal), tmp_path / f"arm{i}.yaml")
    files = sorted(tmp_path.glob("*.yaml"))
    for arm in (Arm("three", nominal), Arm("gantry", nominal, sliding=(0,))):
        rows = folder.fit_files(files, arm)
        assert [(row["result"], row["arm"], row["joints"]) for row in rows] == [(Result.CONVERGED, arm.name, 3)] * 2
        assert all(row["checked_position_max_m"] < 1e-9 for row in rows)
    own = folder.fit_files(files, None)
    assert [row["arm"] for row in own] == ["arm0", "arm1"]
    assert all("this chain is its own nominal arm" in row["message"] for row in own)


# ------------------------------------------------------------------ behind a URL


@pytest.fixture
def stored(arms):
    """The folder's files in fsspec's memory."""
    store = fsspec.filesystem("memory")
    store.put(f"{arms}/", "/fleet/arms", recursive=True)
    yield "memory://fleet/arms"
    store.rm("/fleet", recursive=True)


def test_what_is_behind_a_url_is_fitted_as_a_folder_is(arms, stored, tmp_path):
    recording(arms / "run.csv")
    (arms / "run.yaml").write_text("recording: {arm: own/arm.yaml}\n")
    (arms / "own").mkdir()
    (arms / "own" / "arm.yaml").write_text("name: own\n")
    fsspec.filesystem("memory").put(f"{arms}/", "/fleet/arms", recursive=True)
    rows = [
        list(read_rows(fit_folder(folder, tmp_path / f"{i}.parquet", processes=0)))
        for i, folder in enumerate((arms, stored))
    ]
    shown = [[row | {"message": row["message"].replace(str(arms), stored)} for row in own] for own in rows]
    assert shown[0] == shown[1]
    assert f"{stored}/own/arm.yaml: lacks the key 'kinematics'" in rows[1][-2]["message"]


def test_the_command_takes_a_url(arms, tmp_path, capsys):
    out = tmp_path / "fleet.parquet"
    assert main(["fleet", f"file://{arms}", "--out", str(out), "--processes", "1"]) == 0
    assert "2 of 7 files have no usable fit:" in capsys.readouterr().out
    assert next(row for row in read_rows(out) if row["file"] == "broken.yaml")["message"].startswith(
        f"file://{arms}/broken"
    )


def test_urls_survive_being_paths():
    assert restore_url("s3:/bucket/arms") == restore_url("s3://bucket/arms") == "s3://bucket/arms"
    assert restore_url("file:/tmp/arms") == "file:///tmp/arms"
    assert restore_url("memory:/arms") == "memory://arms"
    assert restore_url("C:/arms") is restore_url("arms") is restore_url("/s3:/arms") is None


def test_urls_that_cannot_be_read_are_one_line(monkeypatch, tmp_path):
    def refused(url):
        with pytest.raises(InputError) as error:
            fit_folder(url, tmp_path / "fleet.parquet", processes=0)
        return str(error.value)

    assert refused("memory://nothing/here") == "memory://nothing/here: no such folder; check the URL"
    assert refused("carrier-pigeon://x").startswith(
        "carrier-pigeon://x: Protocol not known: carrier-pigeon; give a path"
    )
    monkeypatch.setitem(__import__("sys").modules, "fsspec.core", None)
    assert refused("s3://b/x") == "s3://b/x: URLs are read by fsspec; pip install 'lite6jax[distributed]'"


# ------------------------------------------------------------------ arguments


def test_processes_and_a_cluster_are_alternatives(capsys, arms, tmp_path):
    options = ["fleet", str(arms), "--out", str(tmp_path / "f.parquet")]
    assert main([*options, "--processes", "0"]) == 2
    assert "--processes 0: give 1 or more" in capsys.readouterr().err
    assert main([*options, "--processes", "2", "--scheduler", "tcp://127.0.0.1:1"]) == 2
    assert "--processes and --scheduler: give one of them" in capsys.readouterr().err


def test_a_file_whose_process_was_ended_has_a_row_that_says_so(monkeypatch, tmp_path):
    (tmp_path / "b.yaml").write_text("kinematics: {}\n")
    asked = {}
    monkeypatch.setattr("lite6jax.fleet.folder.run_batches", lambda *given, **named: asked.update(named))
    fit_folder(tmp_path, tmp_path / "out.parquet")
    (row,) = asked["died"]("b.yaml").to_pylist()
    assert row["result"] == Result.UNREADABLE
    assert row["message"].startswith("b.yaml: the process that read it was ended")


def test_the_rows_of_a_recording_that_was_ended_are_listed_once(tmp_path):
    for name in ("a.parquet", "a.growing.csv", "a.yaml", "b.growing.csv", "b.yaml", "c.csv"):
        (tmp_path / name).touch()
    home = place.StorageFolder.of(tmp_path)
    listed = ["a.parquet", "b.growing.csv", "c.csv"]
    assert place.list_fleet(home, tmp_path / "rows.parquet") == place.list_recordings(home) == listed
