"""LeRobot data sets of versions 2 and 3, read through the sidecar that names their columns."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typed import unread

from lite6jax.errors import InputError
from lite6jax.recordings import ArmJoints, read_recording, recording_file
from lite6jax.recordings.columns.inspection import inspect
from lite6jax.recordings.files import open_table

NAMES = [f"joint_{k}.pos" for k in range(1, 7)] + ["gripper.pos"]
LENGTHS = (30, 20)


def frames(seed=0):
    rng = np.random.default_rng(seed)
    return [np.cumsum(rng.normal(0, 2, (count, 7)), axis=0).astype(np.float32) for count in LENGTHS]


def dataset(folder, version=3, names=NAMES, kind=None):
    """Two episodes: a file each (version 2), or both in one (version 3)."""
    kind = kind or pa.list_(pa.float32(), 7)
    tables = []
    for episode, state in enumerate(frames()):
        count = len(state)
        tables.append(
            pa.table(
                {
                    "observation.state": pa.array(state.tolist(), kind),
                    "action": pa.array((state + 1).tolist(), kind),
                    "timestamp": pa.array(np.arange(count) / 30, pa.float32()),
                    "frame_index": np.arange(count),
                    "episode_index": np.full(count, episode),
                    "index": np.arange(count),
                    "task_index": np.zeros(count, np.int64),
                }
            )
        )
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    if version == 3:
        pq.write_table(pa.concat_tables(tables), data / "file-000.parquet")
    for episode, table in enumerate(tables if version == 2 else ()):
        pq.write_table(table, data / f"episode_{episode:06d}.parquet")
    vector = {"dtype": "float32", "shape": [7], "names": names}
    scalar = {"dtype": "float32", "shape": [1], "names": None}
    features = {"observation.state": vector, "action": vector, "timestamp": scalar, "episode_index": scalar}
    (folder / "meta").mkdir()
    info = {"codebase_version": f"v{version}.0", "fps": 30, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    return folder


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("kind", [None, pa.list_(pa.float32())], ids=["fixed", "variable"])
def test_the_state_of_all_episodes_is_read(tmp_path, version, kind):
    folder = dataset(tmp_path / "picks", version, kind=kind)
    assert recording_file(folder) == folder
    _, table = open_table(folder, (), ArmJoints(), [])
    found = inspect(list(table.numbers()))
    assert found.columns["observation.state.joint_3.pos"] == "q3_deg"
    assert found.columns["observation.state.gripper.pos"] == found.columns["action.gripper.pos"] == "ignore"
    assert found.columns["action.joint_1.pos"] == "cmd1_deg"
    assert (found.columns["timestamp"], found.columns["episode_index"]) == ("time_s", "run")
    lines = "".join(f"  {own}: {name}\n" for own, name in found.columns.items())
    (tmp_path / "picks.yaml").write_text(f"columns:\n{lines}recording: {{motion: trajectory}}\n")
    recording = read_recording(folder)
    np.testing.assert_allclose(np.rad2deg(recording.joint_position), np.concatenate(frames())[:, :6], rtol=1e-6)
    assert recording.run.tolist() == [0] * 30 + [1] * 20
    np.testing.assert_allclose(np.rad2deg(recording.commanded_position - recording.joint_position), 1, rtol=1e-4)
    np.testing.assert_allclose(recording.time[30:], np.arange(20) / 30, atol=1e-6)
    assert recording.source == str(folder)


def test_without_a_sidecar_its_columns_are_named_and_init_with_them(tmp_path):
    folder = dataset(tmp_path / "picks")
    said = unread(folder)
    assert said.startswith("has no joint positions; name their columns q1_rad")
    assert said.endswith(f"; `lite6jax init {folder}` names columns as they are")


def test_data_sets_that_are_none(tmp_path):
    folder = dataset(tmp_path / "picks")
    part = next((folder / "data").rglob("*.parquet"))
    content = part.read_bytes()
    part.write_text("version https://git-lfs.github.com/spec/v1\n")
    with pytest.raises(InputError, match=r"file-000\.parquet: is not Parquet, whatever its name says"):
        read_recording(folder)
    part.unlink()
    with pytest.raises(InputError, match="picks: has no Parquet files below data; fetch the whole data set"):
        read_recording(folder)
    part.write_bytes(content)
    for text, message in (("{", "is not JSON; restore the file"), ("{}", "names no features, so it is of no LeRobot")):
        (folder / "meta" / "info.json").write_text(text)
        with pytest.raises(InputError, match=rf"info\.json: {message}"):
            read_recording(folder)
