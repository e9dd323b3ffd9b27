"""Bags of ROS: rosbag2 folders (SQLite or MCAP inside) and ROS 1 files, through the package rosbags."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.errors import InputError
from lite6jax.recordings.ros import ArmJoints, Messages, read_log

METADATA = "metadata.yaml"
Array = NDArray[np.floating]


def read_bag(path: Path, topics: Sequence[str], of_arm: ArmJoints, notes: list[str]) -> dict[str, Array]:
    """The table of a bag, as `ros.read_log`.

    Args:
        path: a rosbag2 folder, a `.db3` file in one, or a ROS 1 `.bag`.
        topics, of_arm, notes: as in `ros.read_log`.

    Raises:
        InputError: the package is missing, the bag is damaged or has no metadata, or as there.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(f"{path}: bags take the package rosbags; pip install 'lite6jax[rosbag]'") from error
    bag = path.parent if path.suffix.lower() == ".db3" else path
    if bag != path and not (bag / METADATA).exists():
        raise InputError(f"{path}: has no {METADATA} beside it; write that with `ros2 bag reindex {bag.name}`")
    reader = AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
    try:
        reader.open()
    except Exception as error:  # the package raises whatever the damaged bytes lead to
        raise _damaged(path, error) from error
    try:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        return read_log(path, types, lambda chosen: _messages(path, reader, chosen), topics, of_arm, notes)
    finally:
        reader.close()


def _messages(path: Path, reader: Any, topics: Sequence[str]) -> Messages:
    messages = Messages(topics)
    connections = [connection for connection in reader.connections if connection.topic in topics]
    try:
        for connection, logged, content in reader.messages(connections=connections):
            messages.add(connection.topic, logged, reader.deserialize(content, connection.msgtype))
    except Exception as error:  # as above
        raise _damaged(path, error) from error
    return messages


def _damaged(path: Path, error: Exception) -> InputError:
    problem = " ".join(f"{type(error).__name__} {error}".split())[:100]
    remedy = "recover what is left with `ros2 bag reindex`" if path.is_dir() else "check it with `rosbag info`"
    return InputError(f"{path}: is no bag, truncated or damaged ({problem}); {remedy}, or record again")
