"""What the tests of a score's parts share."""

import pytest


def assert_same_gains(evidence, terms):
    """What is explained of terms, against their scores, and no p-value of white noise above that of the score."""
    for term, explained, score in zip(terms, evidence.explained(terms), evidence.score(terms), strict=True):
        assert explained.confounded == score.confounded, term.label
        assert explained.size == score.size, term.label
        assert explained.gain == pytest.approx(score.gain, rel=1e-6, abs=1e-9), term.label
        assert explained.familywise(30.0) <= score.familywise(30.0) * (1 + 1e-6), term.label
