"""`diagnose --fleet` of a folder: which recordings are pooled, what is refused, and the command from end to end."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fleet.linear_arms import OPTIONS, arm
from typed import flat

from lite6jax.cli import main
from lite6jax.errors import InputError
from lite6jax.fleet.diagnoses import check_pooled, pool_folder


@pytest.fixture
def results(tmp_path):
    """Makes a folder of results, of recordings that are `about` so."""

    def make(*abouts):
        rng, rows = np.random.default_rng(0), []
        for i, about in enumerate(abouts):
            row = {"file": f"a{i}.csv", "result": "unreadable", "message": f"a{i}.csv: no", "reduced": None}
            if about is not None:
                made = arm(rng)
                made.heading.about.update(about)
                (tmp_path / f"a{i}.npz").write_bytes(made.to_bytes())
                row |= {"result": "diagnosed", "message": "", "reduced": f"a{i}.npz"}
            rows.append(row)
        pq.write_table(pa.Table.from_pylist(rows), tmp_path / "summary.parquet")
        return tmp_path

    return make


def pooled(out):
    return pool_folder("arms", out, OPTIONS, processes=0)


def test_those_of_the_most_common_type_are_pooled_and_the_others_say_why_not(results):
    found = pooled(results({}, {"arm": "other", "joints": 6}, {}, None, {"what": "torques"}))
    assert found.used == (0, 2)
    said = {member["file"]: member for member in found.to_dict()["recordings"]}
    assert said["a1.csv"]["reason"] == "is of the arm other with 6 joints, and most are of none with 3"
    assert said["a4.csv"]["reason"] == "has torques, and most have poses; give --torques where all have torques"
    assert (said["a3.csv"]["reason"], said["a3.csv"]["used"]) == ("a3.csv: no", False)
    assert (said["a0.csv"]["reason"], said["a0.csv"]["used"]) == (None, True)


@pytest.mark.parametrize(
    ("abouts", "said"),
    [
        ([None], "^arms: none of its recordings could be diagnosed: a0.csv: no$"),
        ([{}, None], r"^arms: 1 recording can be pooled, and --fleet takes 2 or more \(a1\.csv: no\); add"),
    ],
)
def test_too_few_recordings_are_refused_with_the_remedy(results, abouts, said):
    with pytest.raises(InputError, match=said):
        pooled(results(*abouts))


def test_the_document_has_a_name_of_its_own(tmp_path):
    with pytest.raises(InputError, match=r"fleet\.csv: its diagnosis would be named fleet\.json.*rename the recording"):
        check_pooled(tmp_path, ["a.csv", "fleet.csv"], False)
    (tmp_path / "fleet.json").write_text("")
    with pytest.raises(InputError, match=r"fleet\.json: exists already"):
        check_pooled(tmp_path, ["a.csv"], False)
    check_pooled(tmp_path, ["a.csv"], True)


def test_what_a_fleet_does_not_take_is_one_line(tmp_path, capsys):
    def refused(*options):
        assert main(["diagnose", *map(str, options)]) == 2
        return capsys.readouterr().err

    file, out = tmp_path / "a.csv", tmp_path / "results"
    file.write_text("q1_rad\n")
    assert "--fleet: is for a folder of recordings;" in refused(file, "--fleet")
    assert "add --out DIR for the documents of its recordings" in refused(tmp_path, "--fleet")
    assert "--report: is of one recording, and --fleet" in refused(
        tmp_path, "--fleet", "--out", out, "--report", tmp_path / "r.html"
    )


def test_the_command_pools_what_it_diagnosed(corpus, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    folder, results = tmp_path / "recordings", tmp_path / "results"
    folder.mkdir()
    made = corpus["compliance"]
    for name in ("a", "b"):
        (folder / f"{name}.csv").write_bytes(made.path.read_bytes())
        (folder / f"{name}.yaml").write_bytes(made.path.with_suffix(".yaml").read_bytes())
    for file in made.path.parent.glob("*.yaml"):
        (folder / file.name).write_bytes(file.read_bytes())
    (folder / "broken.csv").write_text("q1_rad\n")
    monkeypatch.setattr("lite6jax.workers.Processes", None)  # in this process, where all is compiled
    monkeypatch.setattr("lite6jax.cli.command.check_processes", lambda processes, scheduler: None)
    options = ["--out", str(results), "--quick", "--processes", "0"]

    assert main(["diagnose", "--fleet", str(folder), *options]) == 0
    said = flat(capsys.readouterr().out)
    document = json.loads((results / "fleet.json").read_text())
    (effect,) = document["effects"]
    assert (effect["effect"], effect["site"]) == ("joint_compliance", "joint2")
    low, high = effect["parameters"]["compliance_rad_per_Nm"]["interval_95"]
    assert low < 9e-5 < high
    assert "2 recordings of lite6 arms were pooled." in said
    assert "1. Joint compliance at joint2:" in said
    assert "1 recording of 3 not pooled:" in said
    assert f"{folder / 'broken.csv'}: " in said
    assert (results / "a.json").read_bytes() != (results / "b.json").read_bytes()  # the names of their inputs
    rows = {row["file"]: row for row in pq.read_table(results / "summary.parquet").to_pylist()}
    assert (rows["a.csv"]["reduced"], rows["broken.csv"]["reduced"]) == ("a.npz", None)
    assert main(["report", str(results / "fleet.json")]) == 0
    assert flat(capsys.readouterr().out) in said
    certificate = ["--certificate", str(tmp_path / "c.pdf")]
    assert main(["report", str(results / "fleet.json"), *certificate]) == 2
    assert "--certificate: is of one recording, and" in flat(capsys.readouterr().err)
    (tmp_path / "damaged.json").write_text(json.dumps(document | {"effects": [{}]}))
    assert main(["report", str(tmp_path / "damaged.json")]) == 2
    assert "is damaged (it lacks '" in flat(capsys.readouterr().err)
    assert main(["diagnose", "--fleet", str(folder), *options]) == 2
    assert "fleet.json: exists already" in flat(capsys.readouterr().err)
