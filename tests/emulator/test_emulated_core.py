"""The emulator's core without sockets or threads.

A controller that ran beside would move the state of `random`, which the run-time type checker draws from, and
Hypothesis takes that for a strategy that is not repeatable.
"""

import struct

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lite6jax.controller import protocol
from lite6jax.controller.protocol import Register
from lite6jax.emulator.core import Client, Core
from lite6jax.emulator.replies import answer, report

EXTREME = st.sampled_from([0.0, 1.0, -3.0, 1e30, -1e30, float("inf"), float("nan"), 1e-30])
BODY = st.one_of(
    st.binary(max_size=60),
    st.lists(EXTREME, max_size=12).map(lambda values: struct.pack(f"<{len(values)}f", *values)),
    st.tuples(st.lists(EXTREME, min_size=6, max_size=10), st.binary(max_size=30)).map(
        lambda parts: struct.pack(f"<{len(parts[0])}f", *parts[0]) + parts[1]
    ),
)


@example(requests=[(36, struct.pack("<4f", 8388608, 0, 0, 1e36))], enabled=False)  # overflowed a report
@settings(max_examples=80)
@given(
    requests=st.lists(st.tuples(st.sampled_from([*Register, 0, 99, 199]), BODY), min_size=1, max_size=6),
    enabled=st.booleans(),
)
def test_nothing_that_is_asked_breaks_it(lite6, requests, enabled):
    core = Core(lite6)
    if enabled:
        core.enabled, core.state = core.every_motor, 2
    told = []
    client = Client(told.append)
    for transaction, (register, body) in enumerate(requests):
        asked = protocol.Frame(register, body, transaction)
        reply = answer(core, asked, client)
        assert reply is not None
        assert (reply.transaction, reply.register) == (transaction, register)
        core.advance(core.time + 0.1)
        for port in protocol.RATES:
            assert len(report(core, port, np.array([core.time, core.time + 0.01]))) == 2 * protocol.LENGTHS[port]
    assert np.isfinite(core.read_encoders(np.array([core.time]))[0]).all()
    assert core.state in (1, 2, 3, 4, 5)
