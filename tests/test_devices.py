"""The same fits on a processor and on an accelerator: answers are right on each that there is."""

import jax
import pytest

from benchmarks import __main__ as harness
from benchmarks import ceres_rival, devices

SMALL = {"arms": (4,), "samples": (300,), "poses": 500, "order": 64, "repeats": 1}


def figures(device):
    found = list(devices.devices(device, **SMALL))
    assert [record.failed for record in found] == [""] * len(found)
    assert all(record.value > 0 for record in found)
    return {subject: [r.metric for r in found if r.subject == subject] for subject in {r.subject for r in found}}


def test_the_processor_alone_has_one_column():
    assert figures("cpu").keys() == {"cpu"}
    assert jax.config.jax_default_device is None


@pytest.mark.skipif(bool(devices.absent("gpu")), reason="JAX sees no GPU here: what runs on one is not tested")
def test_a_gpu_has_a_column_beside_the_processors_with_right_answers():
    found = figures("gpu")
    assert found.keys() == {"cpu", "gpu"}
    assert found["cpu"] == found["gpu"]


def test_a_device_that_is_not_there_is_refused_in_one_line(capsys, monkeypatch):
    def none(device):
        raise RuntimeError(f"Unknown backend: '{device}' requested")

    monkeypatch.setattr(jax, "devices", none)
    assert harness.main(["--device", "gpu"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "--device gpu: JAX sees none here; on a machine with an NVIDIA card pip install 'lite6jax[gpu]'" in said


def test_a_device_runs_its_own_workload_alone():
    asked = []

    def counted(device="cpu"):
        asked.append(device)
        return iter(())

    def other():
        asked.append("other")
        return iter(())

    known = {"devices": counted, "other": other}
    assert harness.main(["--device", "cpu"], known) == 0
    assert asked == ["cpu"]
    assert harness.main([], known) == 0
    assert asked == ["cpu", "other"]
    with pytest.raises(SystemExit):
        harness.main(["other", "--device", "cpu"], known)


def test_a_rival_that_is_not_installed_is_named_in_one_line(capsys, monkeypatch):
    monkeypatch.setattr(ceres_rival.shutil, "which", lambda name: None)
    assert harness.main(["ceres"]) == 2
    said = capsys.readouterr().err
    assert said == "benchmarks: ceres: no C++ compiler or no Ceres here; apt-get install g++ libceres-dev\n"


@pytest.mark.skipif(not ceres_rival.HEADERS.exists(), reason="Ceres (libceres-dev) is not installed here")
def test_ceres_and_the_library_agree():
    found = list(ceres_rival.ceres(arms=2, samples=40, repeats=1))
    assert [record.failed for record in found] == [""] * len(found)
    assert all(record.value > 0 for record in found)
