"""What the documents say of the code is so: files and links exist, tables and orders are those of the code."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "SECURITY.md", *sorted((ROOT / "docs").rglob("*.md"))]
CONTRIBUTING = (ROOT / "docs/CONTRIBUTING.md").read_text()


def table_rows(text):
    """The cells of each row of the tables in a text, without markup."""
    return [
        [cell.strip(" `") for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")
    ]


def anchors(text):
    """What links can point to in a document: its headings as a forge spells them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_the_files_that_a_document_names_exist(document):
    named = re.findall(r"`((?:lite6jax|tests|benchmarks|docs)/[\w./]*)`", document.read_text())
    files = [name for name in named if "NAME" not in name and not name.rpartition("/")[2].isdecimal()]  # schemas
    missing = [name for name in files if not (ROOT / name).exists()]
    assert missing == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_the_links_of_a_document_lead_somewhere(document):
    for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text()):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        path = document.parent / name if name else document
        assert path.exists(), target
        if anchor:
            assert anchor in anchors(path.read_text()), target


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_the_sidecars_that_a_document_shows_are_read(document, tmp_path):
    from lite6jax.recordings.settings import read_settings

    for block in re.findall(r"^```yaml[^\n]*\n(.*?)^```$", document.read_text(), re.MULTILINE | re.DOTALL):
        if re.search("^recording:", block, re.MULTILINE):
            sidecar = tmp_path / "log.yaml"
            sidecar.write_text(block)
            read_settings(sidecar)


def test_the_faults_of_poses_are_documented_in_their_order():
    from lite6jax.domains.pose.screening.screen import SCREENS
    from lite6jax.report.sentences.faults import FAULTS

    documented = [row[0] for row in table_rows((ROOT / "docs/reference/faults.md").read_text())[2:]]
    screened = list(dict.fromkeys(code for screen in SCREENS for code in screen.codes))
    assert documented[: len(screened)] == screened
    assert set(documented) == set(FAULTS["poses"])


def test_the_verdicts_of_a_diagnosis_and_the_keys_of_its_model_are_documented():
    from typing import get_args

    from lite6jax.diagnosis.document import Verdict
    from lite6jax.domains.pose.entry import PoseModelEntry

    text = (ROOT / "docs/reference/results.md").read_text()
    sections = {part.partition("\n")[0]: table_rows(part)[2:] for part in re.split("\n##+ ", text)[1:]}
    keys = {key for row in sections["The model in it"] for key in row[0].replace("`", "").split(", ")}
    assert keys == set(PoseModelEntry.__struct_fields__) - {"prismatic_joints"}
    verdicts = {row[0].strip("*").replace(" ", "_") for row in sections["The verdicts"]}
    assert verdicts == set(get_args(Verdict))


def test_the_screens_are_documented_in_their_order():
    from lite6jax.domains.pose.screening.screen import SCREENS

    section = CONTRIBUTING.partition("### What happens to a recording with swapped joints")[2].partition("\n1. ")[2]
    documented = re.findall(r"`([a-z_]+)`", section.partition("\n\n")[0])
    assert documented == list(dict.fromkeys(code for screen in SCREENS for code in screen.codes))


def test_the_faults_of_commands_and_joints_are_documented():
    from lite6jax.report.sentences.faults import FAULTS

    text = (ROOT / "docs/reference/tracking.md").read_text()
    section = text.partition("\n## Data faults\n")[2].partition("\n## ")[0]
    assert [row[0] for row in table_rows(section)[2:]] == list(FAULTS["tracking"])


def test_the_effects_on_how_joints_follow_are_documented():
    from lite6jax.effects.catalogue import TRACKING_EFFECTS

    text = (ROOT / "docs/reference/tracking.md").read_text()
    section = text.partition("\n## What is fitted\n")[2].partition("\n## ")[0]
    named = {name for row in table_rows(section)[2:] for name in re.findall(r"[a-z]+(?:_[a-z]+)+|backlash", row[1])}
    assert {*TRACKING_EFFECTS} - {"unnamed"} <= named
    catalogue = (ROOT / "docs/reference/effects.md").read_text()
    described = catalogue.partition("\n## Effects on how joints follow their commands\n")[2]
    assert re.findall(r"^### (\w+)$", described, re.MULTILINE) == [*TRACKING_EFFECTS]
    assert described.count("\n**In simulators.**") == described.count("\n**What to do.**") == len(TRACKING_EFFECTS)
    assert described.count("\n**What looks alike.**") == len(TRACKING_EFFECTS) - 1  # nothing is like what has no name


def test_the_effects_and_faults_of_torques_are_documented():
    from lite6jax.effects.catalogue import TORQUE_EFFECTS
    from lite6jax.report.sentences.faults import FAULTS

    text = (ROOT / "docs/reference/torques.md").read_text()
    sections = {part.partition("\n")[0]: table_rows(part)[2:] for part in text.split("\n## ")[1:]}
    assert [row[0] for row in sections["Effects"]] == list(TORQUE_EFFECTS)
    faults = {code for code, texts in FAULTS["torques"].items() if "name" in texts}
    assert {row[0] for row in sections["Data faults"]} == {*faults, "joint_turns"}  # which poses name as well
    for effect, (_, _, _, parameters, *_) in zip(TORQUE_EFFECTS.values(), sections["Effects"], strict=True):
        if effect.nonparametric:
            continue
        given = {name: 2 for name in ("joint", "link") if name in effect.__dataclass_fields__}
        given |= {"source_joint": 1} if "source_joint" in effect.__dataclass_fields__ else {}
        made = effect(**given)
        names = set(parameters.replace("`", "").split(", "))
        reported = set(made.reported(np.ones(made.size)))
        assert reported <= names, effect.name
        assert names - reported <= set(effect.__dataclass_fields__), effect.name  # a usual value is not reported


def test_every_direct_dependency_is_listed_with_its_licence_and_locked():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = {
        *project["dependencies"],
        *(name for names in project["optional-dependencies"].values() for name in names),
    }
    needed = {re.split(r"[<>=\[]", name)[0] for name in wanted} - {"lite6jax"}
    rows = table_rows((ROOT / "docs/dependencies.md").read_text())[2:]
    assert sorted(row[0] for row in rows) == sorted(needed)
    assert all(use and licence for _, use, licence in rows)
    locked = re.findall(
        r"^([\w.-]+)==\S+.*\\\n    --hash=sha256:", (ROOT / ".ci/requirements.txt").read_text(), re.MULTILINE
    )
    assert {name.lower() for name in needed} - {"pre-commit"} <= set(locked)


def test_the_versions_of_python_are_the_same_everywhere():
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["classifiers"]
    versions = [line.rpartition(" ")[2] for line in classifiers if re.search(r":: 3\.\d+$", line)]
    checked = re.search(r"python: \[(.*)\]", (ROOT / ".github/workflows/ci.yml").read_text())[1]
    assert re.findall(r"[\d.]+", checked) == versions
    for name in ("README.md", "docs/index.md", "docs/CONTRIBUTING.md"):
        said = re.findall(r"Python (3\.\d+) to (3\.\d+) on Linux", (ROOT / name).read_text())
        assert said == [(versions[0], versions[-1])], name
    assert "Operating System :: POSIX :: Linux" in classifiers


def test_each_term_of_the_glossary_is_defined_once_and_in_full():
    rows = [row for row in table_rows((ROOT / "docs/glossary.md").read_text()) if row[0] not in ("term", "---")]
    terms = [row[0] for row in rows]
    assert len(terms) == len(set(terms)) > 70
    for term, meaning, _, code in rows:
        assert meaning.endswith("."), term
        assert code, term
