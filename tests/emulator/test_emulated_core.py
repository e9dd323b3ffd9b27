"""The emulator's core without sockets or threads.

A controller that ran beside would move the state of `random`, which the run-time type checker draws from, and
Hypothesis takes that for a strategy that is not repeatable.
"""

import struct

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lite6jax.controller import protocol
from lite6jax.controller.protocol import Register
from lite6jax.emulator import draw_sines
from lite6jax.emulator.core import Core, answer, report

EXTREME = st.sampled_from([0.0, 1.0, -3.0, 1e30, -1e30, float("inf"), float("nan"), 1e-30])
BODY = st.one_of(
    st.binary(max_size=60),
    st.lists(EXTREME, max_size=12).map(lambda values: struct.pack(f"<{len(values)}f", *values)),
    st.tuples(st.lists(EXTREME, min_size=6, max_size=10), st.binary(max_size=30)).map(
        lambda parts: struct.pack(f"<{len(parts[0])}f", *parts[0]) + parts[1]
    ),
)


@settings(max_examples=80)
@given(
    requests=st.lists(st.tuples(st.sampled_from([*Register, 0, 11, 23, 99, 199]), BODY), min_size=1, max_size=6),
    moving=st.booleans(),
)
def test_nothing_that_is_asked_breaks_it(lite6, requests, moving):
    core = Core(lite6, path=draw_sines(lite6.arm) if moving else None)
    for transaction, (register, body) in enumerate(requests):
        reply = answer(core, protocol.Frame(register, body, transaction))
        assert reply is not None
        assert (reply.transaction, reply.register) == (transaction, register)
        core.advance(core.time + 0.1)
        for port in protocol.RATES:
            assert len(report(core, port, np.array([core.time, core.time + 0.01]))) == 2 * protocol.LENGTHS[port]
    assert np.isfinite(core.read_encoders(np.array([core.time]))[0]).all()
    assert core.state == (1 if moving else 4)
