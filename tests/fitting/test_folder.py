"""A folder fitted group by group: a run that was ended goes on with the same bytes, and no file stops the others."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.cli import main
from lite6jax.errors import InputError
from lite6jax.fitting import folder, folder_fit
from lite6jax.fitting.contained import Contained
from lite6jax.fitting.folder_rows import Row, Statistics, write_rows
from lite6jax.fitting.kept_rows import KeptRows
from lite6jax.fitting.solution import Result
from tests.oracles.arms import perturbed

ROOT = Path(__file__).resolve().parents[2]
LITE6 = load_bundled("lite6")


def calibrations(where, count):
    rng = np.random.default_rng(5)
    return [write_factory(perturbed(rng, LITE6.kinematics), where / f"arm{i}.yaml") for i in range(count)]


def recording(path):
    names = ",".join([*(f"q{i}_rad" for i in range(1, 7)), "x_m", "y_m", "z_m"])
    path.write_text(f"{names}\n" + "\n".join(",".join(f"{0.1 * k:.3f}" for k in range(i, i + 9)) for i in range(3)))
    return path


def refuse(recording, nominal):
    """A fit that is quick."""
    raise InputError(f"{recording.source}: refused")


def die_at_some(recording, nominal):
    """A fit that ends the process at recordings named so."""
    if "bad" in recording.source:
        os.kill(os.getpid(), signal.SIGSEGV)
    refuse(recording, nominal)


@pytest.fixture
def fitted(monkeypatch):
    """The groups that are fitted from now on, by the names of their files."""
    groups = []

    def counted(files, *given):
        groups.append([path.name for path in files])
        return real(files, *given)

    real = folder_fit.fit_files
    monkeypatch.setattr(folder_fit, "fit_files", counted)
    return groups


def test_a_row_is_the_same_from_json():
    errors = Statistics(1 / 3, float("inf"), None, float("nan"))
    row = Row(
        "a.yaml", "calibration", Result.CONVERGED, "naïve", "good", "lite6", 6, 300, 4, (("d1_m", 0.1 + 0.2),), errors
    )
    again = Row.from_json(json.loads(json.dumps(row.as_json())))
    assert repr(again) == repr(row)
    assert isinstance(again.result, Result)


def test_a_run_that_was_ended_goes_on_with_the_same_bytes(tmp_path, monkeypatch, fitted):
    monkeypatch.setattr(folder, "GROUP", 2)
    files = [*calibrations(tmp_path, 5), recording(tmp_path / "run.csv")]
    whole = write_rows(folder.fit_folder(files, fit_one=refuse), tmp_path / "whole.parquet").read_bytes()
    groups, out = list(fitted), tmp_path / "fleet.parquet"
    assert [len(group) for group in groups] == [2, 2, 1, 1]
    fitted.clear()

    def stop(done):
        if len(fitted) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        folder.fit_folder(files, progress=stop, fit_one=refuse, kept=KeptRows(out))
    fitted.clear()
    kept = KeptRows(out)
    rows = folder.fit_folder(files, fit_one=refuse, kept=kept)
    assert fitted == groups[1:]  # the second had been fitted but not kept
    assert kept.used == 2
    assert write_rows(rows, out).read_bytes() == whole
    kept.remove()
    assert not kept.path.exists()


def test_what_has_changed_is_fitted_again(tmp_path, fitted):
    files = [calibrations(tmp_path, 1)[0], recording(tmp_path / "run.csv")]
    out = tmp_path / "fleet.parquet"

    def again(*asked):
        fitted.clear()
        folder.fit_folder(files, fit_one=refuse, kept=KeptRows(out, *asked))
        return [name for group in fitted for name in group]

    assert again() == ["arm0.yaml", "run.csv"]
    assert again() == []
    assert again(LITE6) == ["arm0.yaml", "run.csv"]
    (tmp_path / "run.yaml").write_text("recording: {factory_calibration: own.yaml}\n")
    assert again() == ["run.csv"]
    (tmp_path / "own.yaml").write_text("kinematics: {}\n")
    assert again() == ["run.csv"]
    (tmp_path / "run.yaml").write_text("recording: [\n")
    assert again() == ["run.csv"]
    files[0].write_text(files[0].read_text() + "\n")
    assert again() == ["arm0.yaml"]
    assert again() == []
    # the last line cut short, as by a kill
    kept = out.with_name("fleet.parquet.kept")
    kept.write_bytes(kept.read_bytes()[:-20])
    assert again() == ["arm0.yaml"]
    assert again() == []


def test_a_file_of_that_name_that_is_not_ours_is_not_touched(tmp_path):
    (tmp_path / "fleet.parquet.kept").write_text("mine")
    with pytest.raises(InputError, match=r"fleet\.parquet\.kept: is not of a run of fleet; move it away"):
        KeptRows(tmp_path / "fleet.parquet")


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_file_that_ends_the_process_costs_its_own_row(tmp_path):
    files = [tmp_path / name for name in ("arm.yaml", "deep.yaml", "more.yaml")]
    for path in files:
        path.write_text("kinematics: {}\n")
    (tmp_path / "deep.yaml").write_text("[" * 30_000)
    files += [recording(tmp_path / name) for name in ("a.csv", "bad.csv", "c.csv")]
    done = []
    with Contained() as process:
        rows = folder.fit_folder(files, progress=done.append, fit_one=die_at_some, process=process)
    found = {row.file: row for row in rows}
    assert list(found) == [path.name for path in files]
    assert sum(done) == len(files)
    assert all("kinematics must be a mapping" in found[f"{name}.yaml"].message for name in ("arm", "more"))
    assert found["deep.yaml"].result == Result.UNREADABLE
    assert [found[f"{name}.csv"].message.partition(": ")[2] for name in "ac"] == ["refused", "refused"]
    assert found["bad.csv"].kind == "recording"
    assert found["bad.csv"].message.endswith(
        "bad.csv: the process that read it was ended (SIGSEGV); the file is damaged or too large for this machine"
    )


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_fleet_that_was_killed_goes_on(capsys, tmp_path, monkeypatch):
    inputs = tmp_path / "arms"
    inputs.mkdir()
    for i in range(6):
        (inputs / f"arm{i}.yaml").write_text("kinematics: {}\n")
    out, kept = tmp_path / "fleet.parquet", tmp_path / "fleet.parquet.kept"
    program = (
        "import sys, time; from lite6jax.fitting import folder, kept_rows\n"
        "folder.GROUP = 1\n"
        "keep = kept_rows.KeptRows.keep\n"
        "kept_rows.KeptRows.keep = lambda *given: (keep(*given), time.sleep(0.5))\n"
        "from lite6jax.cli import main\n"
        "if __name__ == '__main__': sys.exit(main(sys.argv[1:]))"
    )
    process = subprocess.Popen([sys.executable, "-c", program, "fleet", inputs, "--out", out], cwd=ROOT)
    deadline = time.monotonic() + 60
    while (not kept.exists() or kept.read_bytes().count(b"\n") < 4) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert 2 < kept.read_bytes().count(b"\n") < 6
    monkeypatch.setattr(folder, "GROUP", 1)
    assert main(["fleet", str(inputs), "--out", str(out)]) == 0
    assert "of 6 files had been fitted by a run that was ended" in capsys.readouterr().out
    assert not kept.exists()
    assert main(["fleet", str(inputs), "--out", str(tmp_path / "whole.parquet")]) == 0
    assert out.read_bytes() == (tmp_path / "whole.parquet").read_bytes()
    assert pyarrow.parquet.read_table(out).num_rows == 6


def test_a_fleet_may_have_arms_of_any_number_of_joints(tmp_path):
    rng, nominal = np.random.default_rng(3), LITE6.kinematics[[0, 1, 3]]
    for i in range(2):
        write_factory(perturbed(rng, nominal), tmp_path / f"arm{i}.yaml")
    rows = folder.fit_folder(sorted(tmp_path.glob("*.yaml")), Arm("three", nominal))
    assert [(row.result, row.arm, row.joints) for row in rows] == [(Result.CONVERGED, "three", 3)] * 2


def test_a_death_while_many_are_fitted_together_is_looked_for_one_by_one(monkeypatch, tmp_path):
    def attempt(self, files, given, report):
        if any(path.name == "b.yaml" for path in files):
            return None, None, "SIGKILL"
        return [Row(path.name, "calibration", Result.CONVERGED, "") for path in files], None, ""

    monkeypatch.setattr(Contained, "_attempt", attempt)
    done = []
    rows = Contained().fit([tmp_path / f"{name}.yaml" for name in "abc"], None, refuse, done.append)
    assert [row.file for row in rows] == ["a.yaml", "b.yaml", "c.yaml"]
    assert [row.result for row in rows] == [Result.CONVERGED, Result.UNREADABLE, Result.CONVERGED]
    assert "was ended (SIGKILL)" in rows[1].message
    assert sum(done) == 3
