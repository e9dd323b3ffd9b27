"""The judge of concealed trials: what is right, what is partial, what is misleading; and the rate of wrong names."""

import pytest
from concealed_rows import TRUTH, WAVE, a_finding, a_hidden, a_row

from benchmarks.concealed import campaign, report, scores, statements

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
    return {"findings": list(findings), "verdict": verdict, "after": {"heldout_position_rms_m": rms}}


def grade(hidden, *findings, rows=300, **said):
    document = a_document(*findings, **said)
    return statements.judged(TRUTH | {"hidden": list(hidden)}, document, rows).grade


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


@pytest.mark.parametrize("verdict", ["consistent", "explained"])
def test_a_verdict_that_nothing_is_left_is_false_where_something_is(verdict):
    right = a_finding("joint_compliance", "joint2")
    assert grade([SOFT], right, verdict=verdict, left=1.29) == "right"
    assert grade([SOFT], right, verdict=verdict, left=1.31) == "misleading"
    assert grade([SOFT], right, verdict="partly_explained", left=1.31) == "right"
    turned = a_document(right, verdict=verdict) | {"left": {"orientation_over_noise": 1.4}}
    assert statements.judged(TRUTH | {"hidden": [SOFT]}, turned, 300).grade == "misleading"


def test_a_verdict_that_nothing_is_left_is_false_where_a_large_effect_was_missed():
    assert grade([SOFT], verdict="consistent") == "misleading"  # 100 µm beside a noise of 20 µm
    assert grade([SOFT | {"moved_m": 6e-5}], verdict="consistent", rows=20) == "partial"  # three times the noise
    assert grade([SOFT | {"seen": 0.1}], verdict="consistent") == "partial"  # most of it looks like a frame
    assert grade([SOFT], verdict="undetermined", rows=20) == "partial"


def test_what_theory_says_is_undetectable_need_not_be_found():
    faint = SOFT | {"size": 1.5}
    assert grade([faint], verdict="consistent", rows=20) == "right"
    assert grade([faint], a_finding("joint_lag", "joint1"), rows=20) == "misleading"


def test_both_harmonics_of_a_joint_are_to_be_found():
    second = WAVE | {"parameters": WAVE["parameters"] | {"order": 1.0}}
    one = a_finding("joint_harmonic", "joint3", order=12.0)
    assert grade([WAVE, second], one) == "partial"
    assert grade([WAVE, second], one, a_finding("joint_harmonic", "joint3", order=1.0)) == "right"
    row = a_row([WAVE, second], one, kind="edge")
    assert not row["found"]  # one finding is not both


def test_found_is_effect_and_site_as_hidden_or_as_listed():
    assert a_row([SOFT], a_finding("joint_compliance", "joint2"))["found"]
    assert a_row([SOFT], a_finding("link_compliance", "link1", rivals=[("joint_compliance", "joint2", 0.4)]))["found"]
    other = a_row([SOFT], a_finding("joint_compliance", "joint3"))
    assert (other["detected"], other["found"]) == (True, False)


def test_no_answer_is_misleading():
    assert statements.judged(TRUTH | {"hidden": []}, None, 300) == ("misleading", "no answer")


def a_wrong_and_a_right_one():
    true, false = unnamed("joint4", "position of joint 2"), a_finding("joint_lag", "joint4")
    rows = [a_row([DRIFT], true, kind="outside", index=k) for k in range(3)]
    rows += [a_row([DRIFT], false, kind="outside", index=3), a_row([SOFT], false, kind="edge", index=4)]
    return [*rows, a_row([SOFT], false, kind="single", index=5)]  # what is at stake elsewhere does not count here


def test_the_first_line_is_the_rate_of_wrong_names_with_its_interval():
    rows = a_wrong_and_a_right_one()
    assert scores.wrong_names(rows) == (2, 5)
    title, _, cells = next(iter(report.sections(rows)))
    assert title == "Goals"
    assert cells[0][0] == "wrong names, outside the catalogue and at its edge: 2 %, upper end 4 %"
    assert cells[0][1:] == ("40 % (5.3–85) of 5", "NO")
    assert scores.goals([])[0].met is None


@pytest.mark.parametrize(("trials", "wrong", "met"), [(91, 0, True), (90, 0, False), (300, 6, False), (300, 5, True)])
def test_few_wrong_names_are_few_by_the_upper_end_too(trials, wrong, met):
    row = {"kind": "outside", "statement": "right"}
    rows = [row | {"statement": "misleading"}] * wrong + [row] * (trials - wrong)
    found = scores.wrong_names(rows)
    assert (found.value <= scores.WRONG_NAMES and found.high <= scores.WRONG_NAMES_AT_MOST) == met


def test_orders_that_are_reported_count_in_the_coverage():
    whole = a_hidden("joint_harmonic", "joint3", {"order": 2.0, "amplitude_rad": 1e-4, "phase_rad": 0.1}, size=5.0)
    off = a_row([whole], a_finding("joint_harmonic", "joint3", order=2.1))  # by one standard deviation
    assert [number["name"] for number in scores.numbers([off], 3.0)] == ["order"]
    said = a_finding("joint_harmonic", "joint3", order=2.0)
    said["parameters"]["order"]["std"] = 0.0
    exact = a_row([whole], said)
    assert scores.numbers([exact], 3.0) == []
    assert scores.exact_orders([exact, off]) == (1, 1)


def test_the_story_and_the_results_say_what_was_judged(tmp_path):
    rows = a_wrong_and_a_right_one()
    told = list(report.story(TRUTH | {"hidden": [DRIFT], "edge": "masses off", "mass_errors": [0.1, -0.05]}, rows[3]))
    assert any(line.startswith("Statement: misleading: false: joint_lag@joint4") for line in told)
    assert "  Made hard by: masses off; masses differ by +10 %, -5 %" in told
    campaign.POSES.write_rows(rows, tmp_path / "a.parquet")
    assert [row["statement"] for row in campaign.POSES.read_rows(tmp_path / "a.parquet")][3:] == ["misleading"] * 3
