"""The recovery benchmark: its plan and methods, and what is read from a walk."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.world import World, load_randomization
from hexctl.control.controllers import Controller
from hexctl.control.monitor.monitored_walk import recovering_walk
from hexctl.control.monitor.recovery import StopWalking
from hexctl.control.planning.static_stability import most_stable_slots
from hexctl.control.preparation import WalkStart
from hexctl.errors import InputError
from hexctl.study.paper.evidence import clustered_error
from hexctl.study.recovery.decentralised import LegLoads, phase_rate
from hexctl.study.recovery.episodes import RecoveryCase, RecoveryPlace, Track
from hexctl.study.recovery.methods import DEFAULT_METHODS, METHODS, RecoveryMethod, method_of
from hexctl.study.recovery.recovery_plan import HEADINGS_DEG, HEXAHEAL, LINE
from hexctl.types import RobotState
from tests.robots import ROBOT_NAMES, shipped
from tests.study.made_up_recovery import (
    DELAY_S,
    IDEAL_M_S,
    PACE_HZ,
    alarm,
    changed,
    episode,
    findings,
    on_line,
    plan,
)


class Custom(RecoveryMethod):
    """A custom method."""

    def controller(self, start: WalkStart, to_come: Any) -> Controller:
        return recovering_walk()(start)


def test_methods_have_names_and_custom_ones_a_package() -> None:
    assert DEFAULT_METHODS == ("nothing", "told", "recover")
    searches = {"trial-and-error", "cma-es", "ppo"}
    assert set(METHODS) == {*DEFAULT_METHODS, *searches, "stop-diagnose", "decentralised", "open-loop-best"}
    assert isinstance(method_of(f"{__name__}:Custom"), Custom)
    assert {name for name in METHODS if method_of(name).notices} == {"nothing", "recover", "stop-diagnose"}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hope", "methods"),
        ("no.such.module:Hope", "cannot be loaded"),
        (f"{StopWalking.__module__}:StopWalking", r"StopWalking.*; allowed: a RecoveryMethod"),
    ],
)
def test_what_is_no_method_is_refused(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        method_of(name)


CASE = RecoveryCase(
    gait="tripod", legs=(2,), failure="stuck:tibia", at_s=8.3, heading_deg=60.0, method="recover"
)

ROUGH = RecoveryPlace(
    protocol="line",
    robot=shipped(),
    family="transfer",
    number=205,
    kind="rough",
    world=World(roughness_m=0.003),
    duration_s=20.0,
)


def test_nothing_of_what_will_fail_is_told_in_the_plan() -> None:
    trial = ROUGH.trial(CASE)
    assert (trial.failures, trial.plan.failures, trial.seed, trial.plan.hold) == ((), (), 205, "line")
    assert [str(event) for event in trial.events] == ["2:stuck:tibia@8.3"]
    assert trial.plan.gait.slots == (1, 4, 1, 4, 1, 4)
    assert trial.plan.heading_rad == pytest.approx(math.radians(60))
    auto = ROUGH.trial(replace(CASE, gait="auto", legs=(1, 4), failure="limp"))
    assert auto.plan.gait.slots == most_stable_slots(shipped(), heading_rad=math.radians(60))
    assert [str(event) for event in auto.events] == ["1:limp@8.3", "4:limp@8.3"]


def test_the_first_alarm_of_a_walk_counts() -> None:
    right = episode(CASE)
    assert (right.right_leg, right.right_kind, right.early) == (True, True, ())
    assert right.delay_s == pytest.approx(0.3)
    wrongs: list[tuple[dict[str, Any], bool]] = [
        ({"kind": "limp"}, True),
        ({"joint": None}, True),
        ({"leg": 3}, False),
    ]
    for wrong, leg in wrongs:
        other = episode(CASE, alarms=(alarm(CASE, **wrong),))
        assert (other.right_leg, other.right_kind) == (leg, False)
    early = episode(CASE, alarms=(alarm(CASE, after_s=-2.0), alarm(CASE)))
    assert (early.right_leg, len(early.early)) == (False, 1)
    assert early.delay_s == pytest.approx(0.3)
    missed = episode(CASE, alarms=())
    assert (missed.right_leg, math.isnan(missed.delay_s)) == (False, True)
    intact = replace(CASE, legs=(), failure="intact")
    assert len(episode(intact, alarms=(alarm(CASE),)).early) == 1


def test_a_walk_recovers_that_stays_on_its_feet_and_has_half_of_the_speed() -> None:
    assert episode(CASE, last_m_s=0.5 * IDEAL_M_S).recovered
    assert not episode(CASE, last_m_s=0.49 * IDEAL_M_S).recovered
    fell = episode(CASE, status="fell")
    assert not fell.recovered
    assert math.isnan(fell.final_m)


def test_speeds_are_those_of_the_true_way_along_the_line() -> None:
    """A track 3 cm to the right of the line, of cycles of a second."""
    speeds_m_s = [0.2] * 500 + [0.1] * 500
    track = Track(np.stack([0.02 * np.cumsum(speeds_m_s), np.full(1000, -0.03)], axis=-1), 0.02, 1.0)
    assert track.speed(4.0, 8.0) == pytest.approx(0.2)
    assert track.speed(15.0, 20.0) == pytest.approx(0.1)
    assert math.isnan(track.speed(19.9, 20.0))
    assert track.most_off_m(10.0) == pytest.approx(0.03)
    assert math.isnan(Track(np.zeros((0, 2)), 0.0, 1.0).speed(4.0, 8.0))


def test_every_robot_meets_every_failure_in_every_world_by_every_method() -> None:
    made = plan(robots=(shipped(), shipped("pexod")), gaits=("tripod", "wave"))
    made.check()
    line = [(one, cases) for one, cases in made.walked() if one.protocol == LINE]
    assert [(one.robot.name, one.family, one.number) for one, _ in line] == [
        (robot, family, number)
        for robot in ("ant", "pexod")
        for family in ("transfer", "real")
        for number in (200, 201)
    ]
    for _, cases in line:
        assert len(set(cases)) == len(cases) == 2 * (len(HEADINGS_DEG) + 2 * 2 * 3)
        assert {case.heading_deg for case in cases if not case.legs} == set(HEADINGS_DEG)
    pairs = [(one, cases) for one, cases in made.walked() if one.protocol == HEXAHEAL]
    assert [(one.robot.name, one.number, one.duration_s) for one, _ in pairs] == [
        (robot, run, 14.0) for robot in ("ant", "pexod") for run in (0, 1)
    ]
    for _, cases in pairs:
        assert {case.legs for case in cases} == {(2,), (5,), (2, 5)}
        assert {case.failure for case in cases} == {"limp"}


def test_phase_and_heading_are_drawn_by_the_seed_and_are_the_same_for_all_methods() -> None:
    def drawn(seed: int) -> dict[tuple[Any, ...], set[tuple[float, float]]]:
        found: dict[tuple[Any, ...], set[tuple[float, float]]] = {}
        for one, cases in plan(seed=seed).walked():
            for case in cases:
                key = (one.protocol, one.family, one.number, case.legs, case.failure)
                if case.legs:
                    found.setdefault(key, set()).add((case.at_s, case.heading_deg))
        return found

    first = drawn(0)
    assert first == drawn(0) != drawn(1)
    assert {len(values) for values in first.values()} == {1}
    pace_hz = shipped().gait.pace_hz
    for (protocol, *_), values in first.items():
        ((at_s, heading_deg),) = values
        earliest_s = {LINE: 8.0, HEXAHEAL: 4.0}[protocol]
        assert earliest_s <= at_s <= earliest_s + 1 / pace_hz + 0.01
        assert heading_deg in (HEADINGS_DEG if protocol == LINE else (0.0,))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"families": {"failing": load_randomization("failing")}}, "world"),
        ({"gaits": ("gallop",)}, "gaits"),
        ({"failures": ("stuck:tibia:20",)}, "stuck:JOINT"),
        ({"methods": ("recover",)}, "methods"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan(**options).check()


def test_a_leg_waits_under_its_own_load_and_hurries_once_its_neighbours_carry() -> None:
    u, early = np.full(6, 0.25), np.full(6, 0.75)  # late and early in the stance
    nothing, own, beside = np.zeros(6), np.eye(6)[2], np.eye(6)[1] + np.eye(6)[3]
    assert phase_rate(u, nothing).tolist() == [1.0] * 6
    assert phase_rate(u, own)[2] < 1 < phase_rate(u, beside)[2]
    assert phase_rate(early, own)[2] > 1 > phase_rate(early, beside)[2]
    assert phase_rate(u, 100 * own).min() == 0, "no phase goes back"
    several = phase_rate(np.stack([u, u]), np.stack([own, beside]))
    assert np.array_equal(several, [phase_rate(u, own), phase_rate(u, beside)])


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_loads_are_read_from_torques_else_from_contacts(name: str) -> None:
    robot = shipped(name)
    state = RobotState(robot.stance_angles_rad, 0.0, True)
    loads = LegLoads(robot)
    assert loads.of(state) is None
    contacts = np.array([True, False] * 3)
    np.testing.assert_array_equal(loads.of(replace(state, foot_contacts=contacts)), [1, 0] * 3)
    torques_nm = np.zeros(18)
    torques_nm[4], torques_nm[7] = -1.0, 1.0  # the femur of leg 2 holds the body up, that of leg 3 does not
    read = loads.of(replace(state, joint_torques_nm=torques_nm, foot_contacts=contacts))
    assert read is not None
    assert read[1] > 0
    assert np.count_nonzero(read) == 1


@pytest.mark.slow
def test_the_report_is_one_page_with_all_walks_beside_it(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    made = findings()
    assert made.plan.write(made.rows, tmp_path) == tmp_path / "recovery.html"
    assert {path.name for path in tmp_path.iterdir()} == {"recovery.html", "recovery.parquet"}
    text = (tmp_path / "recovery.html").read_text(encoding="utf-8")
    for words in ("worlds 200 to 201 of transfer and real", "Gaits tripod", "1 cm and 0.5 degrees", "By leg",
                  "16 in 4 worlds", "HexaHeal"):  # fmt: skip
        assert words in text, words
    rows = pq.read_table(tmp_path / "recovery.parquet").to_pylist()
    assert len(rows) == len(made.episodes)
    row = next(row for row in rows if row["method"] == "recover" and row["failure"] == "stuck:tibia")
    assert (row["robot"], row["protocol"], row["family"], row["world"], row["gait"]) == (
        "ant", "line", "transfer", 200, "tripod")  # fmt: skip
    assert (row["right_kind"], row["matters"], row["fell"], row["early_alarms"]) == (True, True, False, 0)
    assert [(one["leg"], one["kind"], one["joint"]) for one in row["alarms"]] == [(2, "stuck", "tibia")]
    (intact, *_) = [row for row in rows if row["failure"] == "intact"]
    assert (intact["matters"], intact["delay_s"]) == (None, None)


def test_statistics_are_those_of_the_episodes() -> None:
    made = findings()
    assert int(made.rows["judged"].sum()) == 3 * 2 * 2 * 4
    found = made.statistics("recover")
    recover = on_line("recover")
    some = [(f"{place.family}:{place.number}", one) for place, one in made.episodes if recover(place, one)]
    final_m, worlds = np.array([one.final_m for _, one in some]), np.array([world for world, _ in some])
    assert (found["episodes"], found["worlds"], found["matter"]) == (16, 4, 16)
    assert [found[name] for name in ("right_leg", "right_kind", "early")] == [16, 16, 0]
    assert found["delay_median"] == pytest.approx(DELAY_S * PACE_HZ)
    assert found["mean_m"] == pytest.approx(final_m.mean())
    assert found["mean_error_m"] == pytest.approx(float(clustered_error(final_m, worlds)))
    assert found["max_m"] == final_m.max()
    assert found["way_p99_m"] == pytest.approx(0.06)
    assert (found["kept"], found["kept_worst"]) == pytest.approx((0.9, 0.9))
    assert [found[name] for name in ("fell", "others", "no_progress")] == [0, 0, 0]


def test_a_failure_matters_that_changes_the_walk_in_which_nothing_is_done() -> None:
    harmless = changed(findings(), on_line("nothing"), signed_m=0.0, after_m_s=0.14)
    cases: list[tuple[dict[str, Any], bool]] = [
        ({}, False),
        ({"signed_m": -0.0191}, True),
        ({"signed_m": -0.018}, False),
        ({"after_m_s": 0.13}, True),
        ({"status": "fell", "after_m_s": math.nan}, True),
    ]
    for changes, matters in cases:
        made = changed(harmless, on_line("nothing"), **changes)
        assert set(made.rows[made.rows["judged"]]["matters"]) == {matters}, changes
