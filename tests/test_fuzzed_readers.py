"""Every reader on damaged files: a value, or one line that says what is wrong."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.damaged import READERS, Trial, damage


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    made = {}

    def trial(reader):
        if reader.name == "mcap":
            pytest.importorskip("rosbags", reason="the package of the extra `rosbag` is not installed")
        if reader.name not in made:
            made[reader.name] = Trial(reader, tmp_path_factory.mktemp("fuzzed"))
        return made[reader.name]

    return trial


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_a_damaged_file_is_read_or_refused(trials, reader):
    trial = trials(reader)

    @settings(max_examples=25, suppress_health_check=list(HealthCheck))
    @given(st.randoms(use_true_random=False))
    def judge(rng):
        assert trial.judged(damage(trial.content, rng)) in (("read", ""), ("refused", ""))

    judge()
