"""Addresses for emulated controllers, and the real SDK, kept from printing, logging and timing others out."""

import contextlib
import io
import logging
import os
import socket
import warnings
from types import SimpleNamespace

import pytest

from lite6jax.arms.description import load_bundled
from lite6jax.emulator import EmulatedArm
from lite6jax.simulation import draw_calibration


@pytest.fixture(scope="session")
def lite6():
    """A Lite 6 as it was made."""
    arm = load_bundled("lite6")
    return EmulatedArm(arm, draw_calibration(arm, seed=1))


@pytest.fixture(scope="session")
def imported_sdk(tmp_path_factory):
    """The SDK, imported once: it makes a log folder at home, prints, and logs to stdout."""
    home, stdout = os.environ.get("HOME"), io.StringIO()
    os.environ["HOME"] = str(tmp_path_factory.mktemp("home"))
    try:
        with contextlib.redirect_stdout(stdout), warnings.catch_warnings(action="ignore"):
            from xarm.core.config.x_config import XCONF
            from xarm.core.utils import log
            from xarm.wrapper import XArmAPI
            from xarm.x3.report import ReportDataStructure
    finally:
        socket.setdefaulttimeout(None)
        if home is None:
            del os.environ["HOME"]
        else:
            os.environ["HOME"] = home
    for handler in list(log.logger.handlers):
        log.logger.removeHandler(handler)
    log.logger.addHandler(logging.NullHandler())
    return SimpleNamespace(XArmAPI=XArmAPI, XCONF=XCONF, ReportDataStructure=ReportDataStructure)


@pytest.fixture(scope="session")
def sdk_reports(imported_sdk):
    return imported_sdk.ReportDataStructure


@pytest.fixture(scope="module")
def connect(imported_sdk):
    """Connects the SDK to a controller; everything is undone at the end of the module."""
    arms, port = [], imported_sdk.XCONF.SocketConf.TCP_CONTROL_PORT

    def connected(controller, **options):
        imported_sdk.XCONF.SocketConf.TCP_CONTROL_PORT = controller.control_port
        with contextlib.redirect_stdout(io.StringIO()):
            arm = imported_sdk.XArmAPI(controller.address, **{"is_radian": True} | options)
        arms.append(arm)
        return arm

    yield connected
    with contextlib.redirect_stdout(io.StringIO()):
        for arm in arms:
            arm.disconnect()
    imported_sdk.XCONF.SocketConf.TCP_CONTROL_PORT = port
    socket.setdefaulttimeout(None)
