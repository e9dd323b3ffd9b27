"""`lite6jax view` as it is typed, its page over HTTP, its scene over the wire, and what its controls do."""

import contextlib
import socket
import struct
import sys
import urllib.request

import numpy as np
import pytest
from report.diagnosed import COMPLIANCE, HARMONIC, LITE6, diagnosed, documented, recording_maker
from report.torque_diagnosed import diagnosed as torques_diagnosed
from report.torque_diagnosed import recorded as torques_recorded
from scipy.spatial.transform import Rotation
from typed import flat, refused, run

from lite6jax.cli.command import list_inputs
from lite6jax.diagnosis.document import model_from_document, read_model, write_document
from lite6jax.domains.predict import predict
from lite6jax.effects.dynamic import CoulombFriction, ViscousFriction
from lite6jax.recordings import read_recording, write_recording
from lite6jax.report import statements
from lite6jax.report.viewer import (
    FOUND,
    MEDIAN_ARROW,
    WITH,
    WITHOUT,
    _rgb,
    joint_scene,
    pose_scene,
    served,
)
from tests.oracles.chains import joint_frames, six_parameter_poses

HOST = "127.0.0.1"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The files of a diagnosis and of its recording."""
    folder = tmp_path_factory.mktemp("arm")
    recording, effects = recording_maker(folder)(COMPLIANCE, HARMONIC)
    path = write_recording(recording, folder / "run7.csv")
    document = {**documented(diagnosed(recording, effects)), "inputs": list_inputs(path)}
    return write_document(document, folder / "diagnosis.json"), path, document


@pytest.fixture(scope="module")
def scene(made):
    _, path, document = made
    return pose_scene(document, model_from_document(document), read_recording(path))


def test_the_arm_stands_as_its_joints_say(scene, made):
    recording = read_recording(made[1])
    expected = [np.broadcast_to(np.eye(4), (recording.samples, 4, 4))]
    expected += joint_frames(LITE6.kinematics, recording.joint_position)
    np.testing.assert_allclose(scene.frames, np.stack(expected, 1), atol=1e-12)
    # each link ends where the next joint is, the last one where the tool is
    after = np.concatenate([scene.frames[:, 1:, :3, 3], scene.frames[:, -1:, :3, 3]], 1)
    for capsule in scene.capsules:
        T = scene.frames[:, capsule.link]
        np.testing.assert_allclose(T[:, :3, :3] @ capsule.start + T[:, :3, 3], T[:, :3, 3], atol=1e-12)
        np.testing.assert_allclose(T[:, :3, :3] @ capsule.end + T[:, :3, 3], after[:, capsule.link], atol=1e-12)


def test_arrows_lead_from_predicted_to_measured_points(scene, made):
    _, path, document = made
    model, recording = model_from_document(document), read_recording(path)
    found, rigid = scene.poses
    assert (found.caption, rigid.caption) == (WITH, WITHOUT)
    flange = six_parameter_poses(LITE6.kinematics, recording.joint_position)[:, :3, 3]  # geometry and frames are known
    np.testing.assert_allclose(rigid.error, recording.position - flange, atol=1e-9)
    np.testing.assert_allclose(found.error, recording.position - predict(model, recording)[:, :3, 3], atol=1e-12)
    ends = rigid.arrows(100.0)
    assert ends.shape == (recording.samples, 2, 3)
    np.testing.assert_allclose(ends[:, 0], flange, atol=1e-9)
    np.testing.assert_allclose(ends[:, 1] - ends[:, 0], 100 * (recording.position - flange), atol=1e-7)
    for errors in (found, rigid):
        usual = np.linalg.norm(np.diff(errors.arrows(errors.scale), axis=1)[:, 0], axis=1)
        assert np.median(usual) == pytest.approx(MEDIAN_ARROW, rel=0.06)  # a scale of two digits
    assert found.median < 0.5 * rigid.median


@pytest.fixture
def shown(scene):
    pytest.importorskip("viser", reason="viser (extra view) is not installed")
    with served(scene, HOST, 0) as shown:
        yield shown


def messages(port, until):
    """What a browser that connects is sent, until a predicate of all so far holds; each as a dictionary."""
    import msgspec
    import viser
    import zstandard
    from websockets.sync.client import connect

    got = []
    with connect(f"ws://{HOST}:{port}", subprotocols=[f"viser-v{viser.__version__}"], max_size=None) as line:
        while not until(got):
            frame = line.recv(timeout=20)
            (length,) = struct.unpack("<Q", frame[8:16])
            packed = zstandard.ZstdDecompressor().decompress(frame[16 : 16 + length])
            got += msgspec.msgpack.decode(packed)["messages"]
    return got


def test_a_browser_gets_the_page_and_the_scene(shown, scene):
    with urllib.request.urlopen(shown.url, timeout=20) as page:
        assert page.status == 200
        assert b"<html" in page.read()
    wanted = {"/errors", "/error", "/predicted", "/arm/0", "/arm/6", "/arm/2/joint2", "/arm/2/joint2/label"}
    sent = messages(shown.server.get_port(), lambda got: wanted <= {message.get("name") for message in got})
    labels = {message["name"]: message["props"]["text"] for message in sent if message["type"] == "LabelMessage"}
    assert labels == {"/arm/2/joint2/label": "1", "/arm/1/joint1/label": "2"}
    html = " ".join(message["props"]["content"] for message in sent if message["type"] == "GuiHtmlMessage")
    assert "Joint 2 gives way to gravity" in html
    assert "Joint compliance at joint2 is significant" in html or "Joint compliance at joint2, a function" in html
    median, scale = 1e3 * scene.poses[-1].median, scene.poses[-1].scale
    assert f"enlarged {scale:.0f} times: the median error of {median:.4f} mm is {scale * median:.0f} mm long" in html
    assert not any(message["type"] == "ThemeConfigurationMessage" and message["show_share_button"] for message in sent)


def test_the_row_moves_the_arm(shown, scene):
    handle = shown.server.scene.get_handle_by_name
    for sample in (0, 41):
        shown.row.value = sample + 1
        for link, T in enumerate(scene.frames[sample]):
            node = handle(f"/arm/{link}")
            np.testing.assert_allclose(node.position, T[:3, 3], atol=1e-6)
            np.testing.assert_allclose(
                Rotation.from_quat(node.wxyz, scalar_first=True).as_matrix(), T[:3, :3], atol=1e-6
            )
        rigid = scene.poses[-1]
        np.testing.assert_allclose(handle("/predicted").position, rigid.predicted[sample, :3, 3], atol=1e-6)
        arrow = rigid.arrows(rigid.scale, [sample])
        np.testing.assert_allclose(handle("/error").points, arrow, atol=1e-6)
        assert f"Row {sample + 1}" in shown._status.content
    shown.playing.value, shown.speed.value = True, 20.0
    shown.play(0.2)
    assert shown.row.value == 46
    shown.play(9.9)
    assert shown.row.value == (45 + 198) % scene.samples + 1  # from the start again
    shown.playing.value = False
    shown.play(1.0)
    assert shown.row.value == (45 + 198) % scene.samples + 1


def test_torques_are_shown_too(capsys, tmp_path, made):
    pytest.importorskip("viser", reason="viser (extra view) is not installed")
    recording = torques_recorded()
    path = write_recording(recording, tmp_path / "torques.csv")
    found = torques_diagnosed(recording, (ViscousFriction(2), CoulombFriction(2))).to_dict()
    document = {**statements.with_statements(found), "inputs": list_inputs(path)}
    file = write_document(document, tmp_path / "torques.json")
    code, out, err = run(capsys, "view", file, "--port", "0", "--duration", "0.1")
    assert (code, err) == (0, "")
    assert f"lite6, 1600 rows of {path}" in flat(out)
    both = write_document({**made[2], "torques": document}, tmp_path / "both.json")
    code, out, err = run(capsys, "view", both, path, "--torques", "--port", "0", "--duration", "0.1")
    assert (code, err) == (0, "")
    assert "Joint 2 has friction" in out
    assert "is a diagnosis of poses; give one of torques" in refused(capsys, "view", made[0], "--torques")
    scene = joint_scene(document, read_model(file, domain="torques"), read_recording(path))
    with served(scene, HOST, 0) as shown:
        handle = shown.server.scene.get_handle_by_name
        sample = 100 + int(scene.joints[1].over_noise[100:-100, 1].argmax())
        shown.row.value = sample + 1
        limit = max(errors.limit for errors in scene.joints)
        for joint, colour in enumerate(scene.joints[1].colours(sample, limit), 1):
            assert tuple(handle(f"/arm/{joint}/joint{joint}").color) == tuple(colour)
        assert f"Row {sample + 1}, {recording.time[sample]:.2f} s: joint 2 is off most, by" in shown._status.content
        assert handle("/arm/2/joint2/label").text == "1, 2"
        assert tuple(handle("/arm/2/joint2/ring").color) == _rgb(FOUND)
        assert handle("/errors") is None


def test_another_file_under_its_name_is_noticed(made, capsys, tmp_path):
    pytest.importorskip("viser", reason="viser (extra view) is not installed")
    document, path, _ = made
    for file in (document, path):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    moved = tmp_path / path.name
    moved.write_text(moved.read_text() + "\n")
    code, _, err = run(capsys, "view", tmp_path / document.name, "--port", "0", "--duration", "0.1")
    assert code == 0
    warned = f"warning: {moved}: is not as it was when diagnosis.json was made from it (their SHA-256 differ)\n"
    assert err == warned
    code, _, err = run(capsys, "view", tmp_path / document.name, path, "--port", "0", "--duration", "0.1")
    assert (code, err) == (0, "")  # asked for
    moved.unlink()
    assert refused(capsys, "view", tmp_path / document.name) == (
        f"{tmp_path / document.name}: the recording run7.csv that it names is not beside it; give one: lite6jax view "
        f"{tmp_path / document.name} RECORDING"
    )


def test_what_is_refused(made, capsys, monkeypatch):
    document, path, _ = made
    assert refused(capsys, "view", document, "--duration", "0") == "--duration 0.0: give seconds above 0"
    assert refused(capsys, "view", document, "--port", "65536") == "--port 65536: is not a port; give 1 to 65535"
    assert "is a recording and no diagnosis" in refused(capsys, "view", path)
    with contextlib.closing(socket.create_server((HOST, 0))) as taken:
        port = taken.getsockname()[1]
        said = refused(capsys, "view", document, "--port", str(port))
        assert said.startswith(f"--host 127.0.0.1 --port {port}: nothing can listen there (")
        assert said.endswith("give another address or port")
    assert refused(capsys, "view", document, "--host", "203.0.113.7").startswith(
        "--host 203.0.113.7: nothing can listen"
    )
    monkeypatch.setitem(sys.modules, "viser", None)
    assert refused(capsys, "view", document) == "view takes the package viser; pip install 'lite6jax[view]'"
