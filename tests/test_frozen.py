"""What is frozen of a diagnosis, and that a changed document is told from an equal one."""

import copy
import json

import pytest

from benchmarks.frozen import command, comparison
from benchmarks.frozen.recordings import Frozen, digest_folder, list_frozen

DOCUMENT = {
    "verdict": "explained",
    "data_faults": [{"fault": "frame_jump", "rows": [120], "numbers": {"jump_m": 2.0e-4}, "statement": "It jumps."}],
    "findings": [
        {"effect": "joint_compliance", "site": "joint2", "parameters": {"compliance": {"value": 9e-5, "std": 5e-6}},
         "p_value": 3.17e-101, "statement": "Joint 2 gives way."},
        {"effect": "joint_harmonic", "site": "joint1", "parameters": {"order": {"value": 100.0, "std": 0.1}},
         "p_value": 2e-9, "statement": "Joint 1 has a wave."},
    ],
    "after": {"heldout_position_rms_m": 3.3e-5},
    "untestable": [{"effect": "joint_lag", "site": "joint1", "reason": "needs the velocity of joint 1"}],
    "ruled_out": [{"fault": "commanded_joints", "numbers": {"reason": "not_round", "share": 0.01}}],
    "model": {
        "T_sensor_base": [[1.0, 0.0, 0.0, 1e-17], [0.0, 1.0, 0.0, 0.3]],
        "uncertainty": {"covariance": [1e-12 * k for k in range(1, 700)], "recorded": {"joint_position_rad": [[0.1]]}},
    },
    "inputs": [{"file": "recording.csv"}],
}  # fmt: skip


def changed(*path, to):
    """The stored document with another value."""
    document = copy.deepcopy(DOCUMENT)
    part = document
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = to
    return comparison.store(document)


STORED = comparison.store(DOCUMENT)


def test_codes_and_numbers_are_stored_without_sentences_files_and_rows():
    text = json.dumps(STORED)
    assert "gives way" not in text
    assert "needs the velocity" not in text
    assert "recording.csv" not in text
    assert "joint_position_rad" not in text
    assert STORED["ruled_out"][0]["numbers"]["reason"] == "not_round"
    assert STORED["data_faults"][0]["rows"] == [120]
    assert comparison.store(STORED) == STORED


def test_of_a_real_arm_nothing_but_verdict_findings_and_faults_is_stored():
    stored = comparison.store(DOCUMENT, real=True)
    assert stored == {
        "verdict": "explained", "findings": STORED["findings"], "data_faults": [{"fault": "frame_jump"}]
    }  # fmt: skip


@pytest.mark.parametrize(
    ("path", "to"),
    [
        (("after", "heldout_position_rms_m"), 3.3e-5 * (1 + 5e-7)),
        (("model", "T_sensor_base", 0, 3), -4e-16),  # rounding of what is zero
        (("findings", 0, "p_value"), 3.17e-101 * (1 + 1e-5)),  # a log-likelihood of 230 with a relative error of 4e-8
    ],
)
def test_rounding_is_no_difference(path, to):
    assert comparison.list_differences(STORED, changed(*path, to=to)) == []


@pytest.mark.parametrize(
    ("path", "to", "line"),
    [
        (("verdict",), "consistent", "verdict: explained → consistent"),
        (("findings",), DOCUMENT["findings"][:1], "finding gone: joint_harmonic@joint1"),
        (("findings",), DOCUMENT["findings"][::-1],
         "findings in another order: joint_harmonic@joint1, joint_compliance@joint2"),
        (("data_faults",), [], "fault gone: frame_jump"),
        (("after", "heldout_position_rms_m"), 3.3001e-5, "after/heldout_position_rms_m: 3.3e-05 → 3.3001e-05 (3e-05)"),
        (("findings", 1, "parameters", "order", "std"), 0.2,
         "findings/joint_harmonic@joint1/parameters/order/std: 0.1 → 0.2 (0.5)"),
        (("findings", 0, "p_value"), 3.17e-102,
         "findings/joint_compliance@joint2/p_value: 3.17e-101 → 3.17e-102"),
        (("model", "T_sensor_base", 1, 3), 0.31, "model/T_sensor_base/1/3: 0.3 → 0.31 (0.03)"),
        (("untestable",), [], "untestable/joint_lag@joint1: gone"),
        (("data_faults", 0, "rows"), [120, 121], "data_faults/frame_jump/rows: 1 → 2 entries"),
    ],
)  # fmt: skip
def test_a_difference_is_said_with_its_path(path, to, line):
    assert line in comparison.list_differences(STORED, changed(*path, to=to))


def test_one_covariance_of_hundreds_is_noticed():
    covariance = [1e-12 * k for k in range(1, 700)]
    covariance[350] *= 1.01
    lines = comparison.list_differences(STORED, changed("model", "uncertainty", "covariance", to=covariance))
    assert [line.partition(":")[0] for line in lines] == ["model/uncertainty/covariance/sum"]


def test_findings_are_compared_by_name_where_one_is_new():
    new = {**DOCUMENT["findings"][0], "effect": "joint_backlash"}
    lines = comparison.list_differences(STORED, changed("findings", to=[new, *DOCUMENT["findings"]]))
    assert lines == ["finding new: joint_backlash@joint2"]


# ------------------------------------------------------------------ the command


@pytest.fixture
def answered(monkeypatch, tmp_path):
    """The command on one recording that is drawn, whose diagnosis says what the test gives."""
    answer = {}

    def prepare(folder):
        (folder / "recording.csv").write_text("q1_rad\n0.1\n")
        return [["diagnose", "recording.csv"]]

    monkeypatch.setattr(command, "list_frozen", lambda: [Frozen("drawn/one", prepare), Frozen("drawn/two", prepare)])
    monkeypatch.setattr(command, "_run", lambda commands, folder: answer["document"])

    def run(document, *arguments):
        answer["document"] = document
        return command.main([*arguments, "--stored", str(tmp_path / "stored")])

    return run


def test_the_command_says_what_is_the_same_and_fails_where_something_differs(answered, capsys):
    assert answered(DOCUMENT, "--write", "--only", "one") == 0
    capsys.readouterr()
    assert answered(DOCUMENT) == 0
    printed = capsys.readouterr().out
    assert "skipped   drawn/two" in printed
    assert printed.splitlines()[-1] == "1 of 1 the same"
    assert answered({**DOCUMENT, "findings": []}) == 1
    printed = capsys.readouterr().out
    assert "finding gone: joint_harmonic@joint1" in printed
    assert printed.splitlines()[-1] == "0 of 1 the same"
    assert answered({"refused": "diagnose"}, "--only", "one") == 1


def test_writing_what_is_missing_keeps_what_is_stored(answered, capsys):
    answered(DOCUMENT, "--write", "--only", "one")
    answered({**DOCUMENT, "verdict": "unexplained"}, "--write", "--missing")
    capsys.readouterr()
    assert answered(DOCUMENT) == 1
    assert capsys.readouterr().out.splitlines()[-1] == "1 of 2 the same"


def test_another_recording_is_no_difference_of_the_tree(answered, monkeypatch, capsys):
    answered(DOCUMENT, "--write", "--only", "one")
    monkeypatch.setattr(command, "digest_folder", lambda folder: "of another file")
    capsys.readouterr()
    assert answered({**DOCUMENT, "findings": []}) == 0
    assert "its files are not those" in capsys.readouterr().out


def test_every_frozen_recording_has_a_name_of_its_own(tmp_path):
    names = [frozen.name for frozen in list_frozen()]
    assert len(set(names)) == len(names)
    drawn = [frozen for frozen in list_frozen() if frozen.source is None]
    assert {frozen.kind for frozen in drawn} == {"trials", "readings", "torque_trials", "tracking", "fleets"}
    (trial,) = (frozen for frozen in drawn if frozen.name == "trials/0")
    digests = []
    for number in range(2):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert trial.prepare(folder)[-1][0] == "diagnose"
        digests.append(digest_folder(folder))
    assert digests[0] == digests[1]
