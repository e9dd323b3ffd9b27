"""The judge of concealed trials: which findings are true, what is misleading, how errors and intervals are counted."""

import numpy as np
import pytest
from trial_answers import TRUTH, WAVE, a_diagnosis, a_finding, a_hidden, a_row

from benchmarks.campaigns import judgement
from benchmarks.campaigns.report import sections
from benchmarks.concealed import campaign
from benchmarks.concealed.campaign import POSES, score

DRIFT = a_hidden(
    *("squared_coupling", "joint4", {"turn_rad": 1e-4}),
    size=10.0,
    drivers=[["position of joint 2"]],
    sites=["joint4", "link4"],
    beside=["joint_coupling", "joint_offset"],
)
PRODUCT = a_hidden(
    "joint_product", "joint4", {"turn_rad": 1e-4}, drivers=[["position of joint 2"], ["position of joint 3"]]
)
YIELDS = a_hidden(
    *("yielding_spring", "joint2", {"turn_rad": 1e-4}),
    drivers=[["gravity torque of joint 2"]],
    sum_of=["joint_compliance", "joint_windup"],
)
SOFT = a_hidden("joint_compliance", "joint2", {"compliance_rad_per_Nm": 1e-5}, size=5.0)


def a_document(*findings, verdict="partly_explained", left=1.0):
    rms = left * 3**0.5 * TRUTH["noise_m"]
    after = {"heldout_position_rms_m": rms}
    return {"findings": list(findings), "data_faults": [], "verdict": verdict, "after": after}


def grade(hidden, *findings, rows=300, **said):
    document = a_document(*findings, **said)
    return judgement.grade(TRUTH | {"hidden": list(hidden), "rows": rows}, document).grade


def unnamed(site, driver, **more):
    return a_finding("unnamed", site, driver=driver, **more)


@pytest.mark.parametrize(
    ("hidden", "findings", "expected"),
    [
        ([DRIFT], [unnamed("joint4", "position of joint 2")], "right"),
        ([DRIFT], [unnamed("link4", "position of joint 2")], "right"),  # no recording tells these sites apart
        ([DRIFT], [unnamed("joint4", "position of joint 1 and position of joint 2")], "right"),
        ([DRIFT], [unnamed("joint4", "time")], "misleading"),
        ([DRIFT], [unnamed("joint3", "position of joint 2")], "misleading"),
        ([DRIFT], [a_finding("joint_harmonic", "joint4", order=2.0)], "misleading"),
        ([DRIFT], [a_finding("joint_coupling", "joint4", source_joint=2.0)], "misleading"),  # the straight part alone
        (
            [DRIFT],
            [unnamed("joint4", "position of joint 2"), a_finding("joint_coupling", "joint4", source_joint=2.0)],
            "right",
        ),
        ([DRIFT], [unnamed("joint4", "position of joint 2"), a_finding("joint_offset", "link4")], "right"),
        ([DRIFT], [a_finding("joint_lag", "joint4", rivals=[("unnamed", "joint4", 2.0)])], "right"),
        ([DRIFT], [a_finding("joint_lag", "joint4", rivals=[("unnamed", "joint4", 7.0)])], "misleading"),
        ([DRIFT], [], "partial"),
        ([PRODUCT], [unnamed("joint4", "position of joint 2")], "partial"),
        ([PRODUCT], [unnamed("joint4", "position of joint 2 and position of joint 3")], "right"),
        ([YIELDS], [unnamed("joint2", "gravity torque of joint 2")], "right"),
        ([YIELDS], [a_finding("joint_compliance", "joint2"), a_finding("joint_windup", "joint2")], "right"),  # its sum
        ([YIELDS], [a_finding("joint_compliance", "joint2"), a_finding("joint_windup", "joint3")], "misleading"),
        ([YIELDS], [a_finding("joint_windup", "joint2")], "misleading"),
        ([SOFT], [a_finding("joint_compliance", "joint2")], "right"),
        ([SOFT], [a_finding("link_compliance", "link1", rivals=[("joint_compliance", "joint2", 0.4)])], "right"),
        ([SOFT], [unnamed("joint2", "gravity torque of joint 2")], "partial"),  # true, but it has a name
        ([SOFT], [a_finding("joint_compliance", "joint3")], "misleading"),
        ([SOFT], [a_finding("joint_compliance", "joint2"), a_finding("base_drift", "base")], "misleading"),
        ([WAVE], [a_finding("joint_harmonic", "joint3", order=13.0)], "misleading"),
        ([], [], "right"),
        ([], [a_finding("joint_lag", "joint1")], "misleading"),
    ],
)
def test_a_statement_is_right_partial_or_misleading(hidden, findings, expected):
    assert grade(hidden, *findings) == expected


def test_a_site_that_no_recording_tells_apart_is_the_right_one():
    """For a function, for the parts of a sum, and in the columns of a row."""
    row = a_row([DRIFT], unnamed("link4", "position of joint 2"), kind="outside")
    assert (row["hidden"][0]["site_found"], row["top_site"]) == (True, True)
    elsewhere = a_row([DRIFT], unnamed("joint3", "position of joint 2"), kind="outside")
    assert (elsewhere["hidden"][0]["site_found"], elsewhere["top_site"]) == (False, False)
    parts = a_finding("joint_compliance", "joint2"), a_finding("joint_windup", "joint2")
    there, away = YIELDS | {"site": "link2", "sites": ["link2", "joint2"]}, YIELDS | {"site": "link2"}
    assert judgement.is_summed(there, parts)
    assert all(judgement.is_true(part, [there], parts) for part in parts)
    assert not judgement.is_summed(away, parts)


def test_sizes_that_were_planned_at_a_bound_are_of_it_in_spite_of_rounding():
    wave = a_hidden("joint_harmonic", "joint3", {"order": 2.0}, size=1.999)
    assert judgement.is_at_least(wave, 2.0)
    assert not judgement.is_at_least(wave | {"size": 1.97}, 2.0)
    finding = a_finding("joint_harmonic", "joint3", order=2.1)
    assert len(judgement.numbers([a_row([wave], finding)], 2.0)) == 1
    assert [cells for title, _, cells in sections(POSES, [a_row([wave], finding)]) if title.startswith("Unseen")]
    soft = SOFT | {"size": 1.999}
    assert grade([soft]) == "partial"
    assert grade([soft], verdict="consistent") == "misleading"


@pytest.mark.parametrize("verdict", ["consistent", "explained"])
def test_a_verdict_that_nothing_is_left_is_false_where_something_is(verdict):
    right = a_finding("joint_compliance", "joint2")
    assert grade([SOFT], right, verdict=verdict, left=1.29) == "right"
    assert grade([SOFT], right, verdict=verdict, left=1.31) == "misleading"
    assert grade([SOFT], right, verdict="partly_explained", left=1.31) == "right"
    turned = a_document(right, verdict=verdict) | {"left": {"over_noise": {"orientation": 1.4}}}
    assert judgement.grade(TRUTH | {"hidden": [SOFT], "rows": 300}, turned).grade == "misleading"


def test_a_verdict_that_nothing_is_left_is_false_where_a_large_effect_was_missed():
    assert grade([SOFT], verdict="consistent") == "misleading"  # 100 µm beside a noise of 20 µm
    assert grade([SOFT | {"moved_m": 6e-5}], verdict="consistent", rows=20) == "partial"  # three times the noise
    assert grade([SOFT | {"seen": 0.1}], verdict="consistent") == "partial"  # most of it looks like a frame
    assert grade([SOFT], verdict="undetermined", rows=20) == "partial"


@pytest.mark.parametrize(
    ("name", "site", "code", "numbers", "expected"),
    [
        ("measurement_scale", "sensor", "sensor_scale", {}, "right"),
        ("joint_offset", "joint5", "joint_turns", {"joint": 5}, "right"),
        ("joint_offset", "joint4", "joint_turns", {"joint": 5}, "misleading"),
        ("measurement_scale", "sensor", "frame_jump", {}, "misleading"),
    ],
)
def test_a_fault_that_says_what_an_effect_is_counts_as_its_name(name, site, code, numbers, expected):
    plan = {"kind": "single", "sizes": [5.0], "rows": 300, "edge": "", "sealed": False, "index": 1}
    truth = {"noise": "as declared", "fault": "", **TRUTH, **plan, "hidden": [a_hidden(name, site, {})]}
    diagnosis = a_diagnosis(faults=[{"fault": code, "numbers": numbers}])
    assert judgement.grade(truth, diagnosis).grade == expected
    row = judgement.score_findings(truth, diagnosis, 1.0, "", "moved_m")
    assert (row["found"], row["detected"]) == (expected == "right", False)


def a_wrong_and_a_right_one():
    true, false = unnamed("joint4", "position of joint 2"), a_finding("joint_lag", "joint4")
    rows = [a_row([DRIFT], true, kind="outside", index=k) for k in range(3)]
    rows += [a_row([DRIFT], false, kind="outside", index=3), a_row([SOFT], false, kind="edge", index=4)]
    return [*rows, a_row([SOFT], false, kind="single", index=5)]  # what is at stake elsewhere does not count here


def test_the_first_line_is_the_rate_of_wrong_names_with_its_interval():
    rows = a_wrong_and_a_right_one()
    assert campaign.wrong_names(rows) == (2, 5)
    title, _, cells = next(iter(sections(POSES, rows)))
    assert title == "Goals"
    assert cells[0][0] == "wrong names, outside the catalogue and at its edge: 2 %, upper end 4 %"
    assert cells[0][1:] == ("40 % (5.3–85) of 5", "NO")
    assert POSES.goals([])[0].met is None


def test_orders_that_are_reported_count_in_the_coverage():
    whole = a_hidden("joint_harmonic", "joint3", {"order": 2.0, "amplitude_rad": 1e-4, "phase_rad": 0.1}, size=5.0)
    off = a_row([whole], a_finding("joint_harmonic", "joint3", order=2.1))  # by one standard deviation
    assert [number["name"] for number in judgement.numbers([off], 3.0)] == ["order"]
    said = a_finding("joint_harmonic", "joint3", order=2.0)
    said["parameters"]["order"]["std"] = 0.0
    exact = a_row([whole], said)
    assert judgement.numbers([exact], 3.0) == []
    assert judgement.exact_orders([exact, off], 3.0) == (1, 1)
    assert judgement.exact_orders([exact], 6.0) == (0, 0)


def test_a_finding_is_the_truth_by_name_site_order_and_source():
    right = a_finding("joint_harmonic", "joint3", order=12.1, amplitude_rad=1e-4, phase_rad=-3.1)
    row = a_row([WAVE], right)
    assert (row["exact"], row["top_named"], row["detected"], row["hidden"][0]["named"]) == (True,) * 4
    assert row["hidden"][0]["numbers"][0]["off"] == pytest.approx(2 * np.pi - 6.2)  # a phase goes round
    assert not a_row([WAVE], a_finding("joint_harmonic", "joint3", order=12.3, amplitude_rad=1e-4))["exact"]
    elsewhere = a_row([WAVE], a_finding("joint_harmonic", "joint2", order=12.0))
    assert not elsewhere["top_site"]
    assert elsewhere["detected"]
    pulled = a_hidden("joint_coupling", "joint3", {"coupling": 1e-4, "source_joint": 2.0})
    assert a_row([pulled], a_finding("joint_coupling", "joint3", coupling=1e-4, source_joint=2.0))["exact"]
    assert not a_row([pulled], a_finding("joint_coupling", "joint3", coupling=1e-4, source_joint=4.0))["exact"]


def test_bars_hold_unseen_positions_or_not():
    """Noise is drawn for the truth, and counts beside the bars: a row that is far off is not within them."""
    shown = {name: [0.1, 0.2] for name in ("x_m", "y_m", "z_m")} | {"outside": [0.0, 1.0]}
    truth = TRUTH | {"hidden": [], "noise_m": 2e-5, "unseen_position_m": [[0.1, 0.1, 0.1], [0.2, 0.2, 0.3]]}
    bars = {f"{axis}_std_m": [1e-3, 1e-3] for axis in "xyz"}
    row = score(truth, a_diagnosis(), shown | bars, 1, "")
    assert (row["inside_components"], row["inside_covered"]) == (3.0, 3.0)
    assert (row["outside_components"], row["outside_covered"]) == (3.0, 2.0)
    assert campaign.within_bars([row], "inside") == 1.0
    assert campaign.within_bars([row], "outside") == pytest.approx(2 / 3)
    assert np.isnan(campaign.within_bars([score(truth, a_diagnosis(), shown, 1, "")], "inside"))


def test_shares_have_the_intervals_of_clopper_and_pearson():
    found = judgement.share([True] * 95 + [False] * 5)
    assert (found.low, found.high) == pytest.approx((0.8872, 0.9836), abs=1e-4)
    assert judgement.Share(0, 367).high == pytest.approx(0.01, abs=1e-4)
    assert (judgement.Share(0, 5).low, judgement.Share(5, 5).high) == (0.0, 1.0)
    assert str(judgement.Share(0, 0)) == "none"
