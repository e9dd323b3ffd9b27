"""Commands as they are typed: what they print, and the one line with which they, or functions, refuse."""

import os
from unittest import mock

import pytest

from lite6jax import cli
from lite6jax.errors import InputError
from lite6jax.recordings import read_recording
from lite6jax.recordings.files import split_topics


def run(capsys, *arguments, width=80):
    """Exit code, stdout and stderr of a command."""
    with mock.patch.dict(os.environ, {"COLUMNS": str(width)}):
        code = cli.main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    return code, said.out, said.err


def refused(capsys, *arguments):
    """The one line on stderr of a command whose input cannot be used."""
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err.removeprefix("error: ").rstrip("\n")


def refusal(call, *args, **kwargs):
    """The whole line with which a call refuses."""
    with pytest.raises(InputError) as error:
        call(*args, **kwargs)
    assert "\n" not in str(error.value)
    return str(error.value)


def unread(path, call=read_recording, **options):
    """The line with which a file is refused, after its name."""
    message, (file, _) = refusal(call, path, **options), split_topics(path)
    assert message.startswith(f"{file}: ")
    return message.removeprefix(f"{file}: ")


def flat(text):
    """Without the line breaks of a narrow screen."""
    return " ".join(text.split())
