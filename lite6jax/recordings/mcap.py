"""Logs in MCAP files, as ROS 2 and other recorders write them: their topics and decoded messages."""

from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.errors import InputError
from lite6jax.recordings.ros import ArmJoints, Messages, read_log

Array = NDArray[np.floating]


def read_mcap(path: Path, topics: Sequence[str], of_arm: ArmJoints, notes: list[str]) -> dict[str, Array]:
    """The table of a log, as `ros.read_log`.

    Raises:
        InputError: a package is missing, the file is no MCAP file or damaged, messages are not of ROS 2, or as there.
    """
    with open(path, "rb") as file:
        types = _topics(path, file)
        return read_log(path, types, lambda chosen: _messages(path, file, chosen), topics, of_arm, notes)


def _packages(path: Path) -> Callable[[IO[bytes]], Any]:
    """What opens a stream as an MCAP reader that decodes messages of ROS 2."""
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise InputError(
            f"{path}: MCAP files take the packages mcap and mcap-ros2-support; pip install 'lite6jax[mcap]'"
        ) from error
    return lambda stream: make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])


def _damaged(path: Path, file: IO[bytes], error: Exception) -> InputError:
    file.seek(0)
    if file.read(8) != b"\x89MCAP0\r\n":
        return InputError(f"{path}: is not an MCAP file, whatever its name says; check the file")
    problem = " ".join(f"{type(error).__name__} {error}".split())[:100]
    return InputError(
        f"{path}: is truncated or damaged ({problem}); recover what is left with `mcap recover`, or record again"
    )


def _topics(path: Path, file: IO[bytes]) -> dict[str, str]:
    """The type of each topic."""
    open_log = _packages(path)
    types: dict[str, str] = {}
    try:
        reader = open_log(file)
        summary = reader.get_summary()
        if summary is not None:
            for channel in summary.channels.values():
                schema = summary.schemas.get(channel.schema_id)
                types[channel.topic] = "" if schema is None else schema.name
        if not types:
            file.seek(0)
            for schema, channel, _ in reader.iter_messages():
                types[channel.topic] = "" if schema is None else schema.name
    except Exception as error:  # the packages raise whatever the damaged bytes lead to
        raise _damaged(path, file, error) from error
    return types


def _messages(path: Path, file: IO[bytes], topics: Sequence[str]) -> Messages:
    from mcap.exceptions import DecoderNotFoundError

    open_log = _packages(path)
    messages = Messages(topics)
    try:
        file.seek(0)
        with redirect_stderr(StringIO()):  # where the decoder prints what it cannot parse
            for _, channel, message, decoded in open_log(file).iter_decoded_messages(topics=list(topics)):
                messages.add(channel.topic, message.log_time, decoded)
    except DecoderNotFoundError as error:
        raise InputError(
            f"{path}: the messages of {' or '.join(topics)} are not CDR with a ros2msg definition, as ROS 2 writes; "
            "convert the log with `ros2 bag convert`"
        ) from error
    except Exception as error:  # the packages raise whatever the damaged bytes lead to
        raise _damaged(path, file, error) from error
    return messages
