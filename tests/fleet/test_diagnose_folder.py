"""The recordings of a folder diagnosed: a document for each, and a table of all."""

import json
import sys

import pyarrow.parquet as pq
import pytest
from typed import flat

from lite6jax.cli import main
from lite6jax.errors import InputError
from lite6jax.fleet.diagnoses import DIAGNOSED, SCHEMA, UNREADABLE, diagnose_folder, make_row
from tests.batch_work import diagnosed


@pytest.fixture
def recordings(tmp_path):
    """A folder of files of which `diagnosed` makes documents."""
    folder = tmp_path / "recordings"
    folder.mkdir()
    for name, verdict in (("a.csv", "consistent"), ("b.csv", "explained"), ("b.parquet", "unnamed"), ("c.csv", "")):
        (folder / name).write_text(verdict)
    (folder / "a.yaml").write_text("recording: {}\n")
    (folder / "notes.txt").write_text("")
    return folder


def ran(recordings, out, **options):
    return diagnose_folder(recordings, out, diagnosed, (str(out.parent),), processes=0, **options)


def worked_on(folder):
    file = folder / "done"
    said = file.read_text().split() if file.exists() else []
    file.unlink(missing_ok=True)
    return said


def test_each_recording_has_a_document_and_a_row(recordings, tmp_path):
    path = ran(recordings, tmp_path / "results")
    assert path == tmp_path / "results" / "summary.parquet"
    table = pq.read_table(path)
    assert table.schema.equals(SCHEMA)
    rows = {row["file"]: row for row in table.to_pylist()}
    assert {name: row["document"] for name, row in rows.items()} == {
        "a.csv": "a.json",
        "b.csv": "b.csv.json",
        "b.parquet": "b.parquet.json",
        "c.csv": None,
    }
    written = {path.name: path.read_text() for path in (tmp_path / "results").glob("*.json")}
    assert written == {f"{name}.json": f"document of {file}" for name, file in
                       (("a", "a.csv"), ("b.csv", "b.csv"), ("b.parquet", "b.parquet"))}  # fmt: skip
    assert (rows["a.csv"]["result"], rows["a.csv"]["verdict"], rows["a.csv"]["samples"]) == (DIAGNOSED, "consistent", 7)
    assert rows["a.csv"]["findings"] == [{"domain": "poses", "effect": "joint_lag", "site": "joint1", "p_value": 0.5}]
    assert (rows["c.csv"]["result"], rows["c.csv"]["message"]) == (UNREADABLE, f"{recordings}/c.csv: no")


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_recording_at_which_processes_end_is_a_row_that_says_so(recordings, tmp_path):
    (recordings / "b.csv").write_text("die")
    run = diagnose_folder(recordings, tmp_path / "results", diagnosed, (str(tmp_path),), processes=2)
    said = {row["file"]: (row["result"], row["message"]) for row in pq.read_table(run).to_pylist()}
    assert said["a.csv"] == (DIAGNOSED, "")
    assert said["b.csv"] == (
        UNREADABLE, "b.csv: the process that read it was ended; the file is damaged or too large for this machine"
    )  # fmt: skip
    assert worked_on(tmp_path).count("b.csv") == 2  # as the reason may have been another


def test_recordings_behind_a_url_give_the_same_documents(recordings, tmp_path):
    fsspec = pytest.importorskip("fsspec", reason="the extra distributed is not installed")
    store = fsspec.filesystem("memory")
    store.put(f"{recordings}/", "/recorded", recursive=True)
    try:
        results = {url: ran(url, tmp_path / url[:4]) for url in ("memory://recorded", f"file://{recordings}")}
    finally:
        store.rm("/recorded", recursive=True)
    here = ran(recordings, tmp_path / "here").parent
    for run in results.values():
        for document in here.glob("*.json"):
            assert (run.parent / document.name).read_bytes() == document.read_bytes()
        rows = {row["file"]: row["result"] for row in pq.read_table(run).to_pylist()}
        assert rows == {"a.csv": DIAGNOSED, "b.csv": DIAGNOSED, "b.parquet": DIAGNOSED, "c.csv": UNREADABLE}


def test_documents_are_not_replaced_unasked(recordings, tmp_path):
    results = tmp_path / "results"
    results.mkdir()
    (results / "a.json").write_text("mine")
    with pytest.raises(InputError, match=r"a\.json: exists already"):
        ran(recordings, results)
    assert worked_on(tmp_path) == []
    ran(recordings, results, overwrite=True)
    with pytest.raises(InputError, match=r"summary\.parquet: exists already"):
        ran(recordings, results)
    with pytest.raises(InputError, match="is the folder of the recordings; write to another"):
        ran(recordings, recordings)
    with pytest.raises(InputError, match="is not a folder; name one to write the diagnoses to"):
        ran(recordings, results / "a.json")
    (results / "summary.parquet").unlink()
    with pytest.raises(InputError, match=r"has no recording \(\.csv, .*\); name another folder"):
        ran(results, tmp_path / "more")


def test_rows_of_torques_and_of_both():
    torques = {
        "domain": "torques",
        "schema": "lite6jax/diagnosis/3",
        "model": {},
        "verdict": "explained",
        "before": {"heldout_torque_rms_Nm": 2.0},
        "after": {"heldout_torque_rms_Nm": 1.0},
        "samples": 9,
        "data_faults": [],
        "findings": [{"effect": "viscous_friction", "site": "joint1", "p_value": 0.0}],
    }
    (row,) = make_row("a.csv", torques, "").to_pylist()
    assert (row["verdict"], row["torque_verdict"], row["before_torque_rms_Nm"]) == (None, "explained", 2.0)
    both = torques | {"domain": "poses", "quality": {"verdict": "bad"}, "before": {"heldout_position_rms_m": 3.0}}
    both |= {"after": {}, "torques": torques, "verdict": "unnamed"}
    (row,) = make_row("a.csv", both, "").to_pylist()
    assert (row["verdict"], row["torque_verdict"], row["before_position_rms_m"]) == ("unnamed", "explained", 3.0)
    assert [found["domain"] for found in row["findings"]] == ["poses", "torques"]


def test_the_command_writes_of_each_what_it_writes_of_one(corpus, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    made = corpus["clean"]
    folder = tmp_path / "recordings"
    folder.mkdir()
    for path in (made.path, made.path.with_suffix(".yaml")):
        (folder / path.name).write_bytes(path.read_bytes())
    for file in made.path.parent.glob("*.yaml"):
        (folder / file.name).write_bytes(file.read_bytes())
    (folder / "broken.csv").write_text("q1_rad\n")
    alone = tmp_path / "alone.json"
    options = ["--quick", "--poses"]
    assert main(["diagnose", str(folder / made.path.name), "--out", str(alone), *options]) == 0
    capsys.readouterr()
    monkeypatch.setattr("lite6jax.workers.Processes", None)  # in this process, where all is compiled
    monkeypatch.setattr("lite6jax.cli.command.check_processes", lambda processes, scheduler: None)
    results = tmp_path / "results"
    assert main(["diagnose", str(folder), "--out", str(results), *options, "--processes", "0"]) == 0
    said = capsys.readouterr().out
    assert (results / made.path.with_suffix(".json").name).read_bytes() == alone.read_bytes()
    rows = {row["file"]: row for row in pq.read_table(results / "summary.parquet").to_pylist()}
    assert rows[made.path.name]["verdict"] == json.loads(alone.read_text())["verdict"]
    assert "1 of 2 recordings were not diagnosed:" in said
    assert f"{folder / 'broken.csv'}: " in flat(said)
    assert made.path.name in said


def test_what_a_folder_does_not_take_is_one_line(recordings, tmp_path, capsys):
    def refused(*options):
        assert main(["diagnose", str(recordings), *map(str, options)]) == 2
        return capsys.readouterr().err

    assert "is a folder; add --out DIR for the documents of its recordings" in refused()
    out = tmp_path / "results"
    assert "--report: is of one recording, and" in refused("--out", out, "--report", tmp_path / "r.html")
    assert "--reference: is of one recording" in refused("--out", out, "--reference", recordings / "a.csv")
    assert main(["diagnose", str(recordings / "a.csv"), "--scheduler", "tcp://127.0.0.1:1"]) == 2
    assert "--scheduler: is for a folder of recordings;" in capsys.readouterr().err
