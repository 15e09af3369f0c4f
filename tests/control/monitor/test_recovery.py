"""What policies decide."""

import math
from pathlib import Path

import numpy as np
import pytest

from hexctl import Failure, TrialPlan, make_gait
from hexctl.control.assessment import crawl
from hexctl.control.assessment.crawl import CRAWL_SWING
from hexctl.control.assessment.top_speed import JointPath, fast_gaits
from hexctl.control.monitor import recovery
from hexctl.control.monitor.posture_trial import MOST_HASTE, TOLD_RISE, PostureTrial
from hexctl.control.monitor.recovery import GlideToStableGait, Response, StopWalking, WalkOn
from hexctl.control.monitor.repertoire import save_repertoire
from hexctl.control.trial_plan import Hold
from hexctl.gait.gait import Motion, ideal_speed_m_s
from hexctl.gait.posture import Posture
from tests.control.monitor.repertoires import (
    OTHER,
    made_up,
    situation,
)
from tests.robots import ROBOT_NAMES, shipped


def _plan(name: str = "ant") -> TrialPlan:
    return TrialPlan(gait=make_gait(shipped(name), "tripod"), hold="line")


STUCK, GONE = Failure(leg=2, kind="stuck", joint="femur"), Failure(leg=2, kind="missing")


def test_nothing_a_stop_and_the_plan_once_all_legs_are_whole() -> None:
    policy, plan = GlideToStableGait(), _plan()
    assert WalkOn().respond(shipped(), plan, 0.0, (Failure(leg=2),)) == Response()
    assert StopWalking().respond(shipped(), plan, 0.0, (Failure(leg=2),)) == Response(stop=True)
    assert policy.respond(shipped(), plan, 0.0, ()) == Response(gait=plan.gait)
    without_three = [Failure(leg=leg, kind="limp") for leg in (1, 3, 5)]
    assert policy.respond(shipped(), plan, 0.0, without_three) == Response(stop=True)


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("legs", [(1,), (2, 5)])
def test_failed_legs_are_tucked_and_the_others_walk_a_gait_of_their_own(
    name: str, legs: tuple[int, ...]
) -> None:
    policy, plan = GlideToStableGait(), _plan(name)
    response = policy.respond(shipped(name), plan, 0.0, [Failure(leg=leg) for leg in legs])
    assert response.gait is not None
    assert response.gait.posture.tucked_legs == legs
    assert response.gait.posture.body_raise > 0
    assert sorted(response.gait.slots) == [1, 2, 3, 4, 5, 6]
    assert response.gait.pace_hz == plan.gait.pace_hz


@pytest.mark.parametrize(
    ("kind", "legs", "heights"),
    [("limp", (1, 2), [-1, 1]), ("missing", (1, 2), [-1, 1]), ("locked", (1, 2), [1]), ("limp", (1,), [1])],
)
def test_over_two_legs_that_drag_the_body_sinks_and_the_other_height_is_tried(
    kind: str, legs: tuple[int, ...], heights: list[int]
) -> None:
    response = GlideToStableGait(None).respond(
        shipped(), _plan(), 0.0, [Failure(leg=leg, kind=kind) for leg in legs]
    )
    assert response.gait is not None
    gaits = (response.gait, *response.tries)
    speeds_m_s = [ideal_speed_m_s(shipped(), gait, Motion()) for gait in (_plan().gait, *gaits)]
    assert speeds_m_s == pytest.approx([speeds_m_s[0]] * len(speeds_m_s))
    assert [math.copysign(1, gait.posture.body_raise) for gait in gaits] == heights


@pytest.mark.parametrize(
    ("speeds", "walked"),
    [((0.2, 0.6), [1]), ((0.28, 0.2), [1, 0]), ((0.4, 0.9), []), ((0.2, 0.23), [1])],
)
def test_a_slow_robot_changes_its_posture_and_walks_the_fastest(
    speeds: tuple[float, float], walked: list[int]
) -> None:
    """Twenty cycles of 50 ticks; every third position is unknown."""
    gaits = [make_gait(shipped(), "tripod"), make_gait(shipped(), "wave")]
    trial, now, progress_m, changes = PostureTrial(gaits, 50.0, 0.003), 0, 5.0, []
    for tick in range(1000):
        progress_m += 0.003 * speeds[now] * trial.haste
        gait = trial.update(progress_m if tick % 3 else math.nan)
        if gait is not None:
            now = gaits.index(gait)
            changes.append(now)
    assert changes == walked


def test_a_robot_that_loses_its_position_is_not_slow() -> None:
    """It walks at half of its speed; the position is unknown for four cycles in every eight."""
    gaits = [make_gait(shipped(), "tripod"), make_gait(shipped(), "wave")]
    trial = PostureTrial(gaits, 50.0, 0.003)
    changes = [trial.update(0.0015 * tick if tick % 400 < 200 else math.nan) for tick in range(2000)]
    assert set(changes) == {None}


@pytest.mark.parametrize(("share", "haste"), [(1.1, 1.0), (0.8, 1.25), (0.7, 1 / 0.7), (0.4, MOST_HASTE)])
@pytest.mark.parametrize("freezes", [False, True])
def test_a_robot_that_falls_short_steps_faster_while_it_knows_its_position(
    share: float, haste: float, freezes: bool
) -> None:
    """A robot makes the share of its commanded speed, at any pace; its position is lost at the end."""
    gaits = [make_gait(shipped(), "tripod"), make_gait(shipped(), "wave")]
    trial, progress_m, hastes, told = PostureTrial(gaits, 50.0, 0.003), 0.0, [1.0], list[float]()
    for tick in range(2000):
        if tick < 1500:
            progress_m += 0.003 * share * trial.haste
        elif not freezes:
            progress_m = math.nan
        assert trial.update(progress_m) is None
        hastes.append(trial.haste)
        if (rise := trial.rise()) is not None:
            told.append(rise)
    assert np.abs(np.diff(hastes)).max() <= 1 / 50 + 1e-9
    assert hastes[1500] == pytest.approx(haste, rel=0.01)
    assert hastes[-1] == 1.0
    assert [1.0, *told][-1] == pytest.approx(haste, abs=TOLD_RISE)


def test_the_posture_of_the_plan_is_kept() -> None:
    gait = make_gait(shipped(), "wave")
    raised = Posture(body_raise=0.03, tucked_legs=(6,))
    plan = TrialPlan(
        gait=type(gait)(slots=gait.slots, pace_hz=0.5, amplitude=0.1, height=0.05, posture=raised)
    )
    response = GlideToStableGait().respond(shipped(), plan, 0.0, [Failure(leg=2)])
    assert response.gait is not None
    assert response.gait.posture.body_raise == 0.03
    assert response.tries == ()
    assert response.gait.posture.tucked_legs == (2, 6)
    assert response.gait.pace_hz * response.gait.strokes_per_cycle == pytest.approx(0.5 * 1.5)


def test_gaits_are_ready_before_the_walk() -> None:
    """A response within a tick only looks them up."""
    policy, plan = GlideToStableGait(), _plan()
    policy.prepare(shipped(), plan, 0.5)
    known = crawl._gait_without.cache_info().misses
    for leg in range(1, 7):
        policy.respond(shipped(), plan, 0.5, [Failure(leg=leg, kind="locked")])
        policy.respond(shipped(), plan, 0.5, [Failure(leg=leg), Failure(leg=leg % 6 + 1)])
    assert crawl._gait_without.cache_info().misses == known


@pytest.mark.parametrize(
    ("gait", "failure", "chosen", "did"),
    [
        ("tripod", STUCK, "tripod", "walked on: 20%"),
        ("wave", STUCK, "tripod", "changed to slots 1,4,1,4,1,4: 20%"),
        ("wave", GONE, None, "changed to slots 2,1,3,4,5,6: 13%"),
    ],
)
def test_by_its_repertoire_it_takes_what_was_faster_at_the_pace_of_the_walk_and_says_why(
    gait: str, failure: Failure, chosen: str | None, did: str
) -> None:
    plan = TrialPlan(gait=make_gait(shipped(), gait, pace_hz=0.85), hold="line")
    response = GlideToStableGait(made_up()).respond(shipped(), plan, 0.1, [failure])
    wanted = make_gait(shipped(), chosen, pace_hz=0.85) if chosen else OTHER.gait(plan.gait)
    assert response.gait == wanted
    assert str(response).startswith(did)


@pytest.mark.parametrize(
    ("gait", "hold", "heading_rad", "failures"),
    [
        ("tripod", "none", 0.0, [STUCK]),
        ("tripod", "line", 0.5, [STUCK]),  # a direction that was not walked
        ("tripod", "line", 0.0, [Failure(leg=2, kind="locked")]),
        ("tripod", "line", 0.0, [STUCK, Failure(leg=4, kind="limp")]),
    ],
)
def test_what_the_repertoire_has_not_walked_is_left_to_the_margin(
    gait: str, hold: Hold, heading_rad: float, failures: list[Failure]
) -> None:
    plan = TrialPlan(gait=make_gait(shipped(), gait), hold=hold)
    by_margin = GlideToStableGait(None).respond(shipped(), plan, heading_rad, failures)
    assert GlideToStableGait(made_up()).respond(shipped(), plan, heading_rad, failures) == by_margin
    same = made_up(situation([[0.9, 0.9], [0.5, 0.5], [0.9, 0.9]]))  # the safest gait is the best
    assert GlideToStableGait(same).respond(shipped(), plan, heading_rad, failures) == by_margin


def test_a_repertoire_is_read_before_the_walk_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    save_repertoire(made_up(), tmp_path / "runs" / "repertoires" / "ant.npz")
    monkeypatch.chdir(tmp_path)
    policy, unprepared = GlideToStableGait(), GlideToStableGait()
    policy.prepare(shipped(), _plan(), 0.0)
    monkeypatch.setattr(recovery, "find_repertoire", None)
    assert policy.respond(shipped(), _plan(), 0.0, [STUCK]).stays
    assert not unprepared.respond(shipped(), _plan(), 0.0, [STUCK]).stays


@pytest.mark.slow
@pytest.mark.parametrize(("legs", "swing_share"), [((2,), 2 / 5), ((1, 2), CRAWL_SWING)])
def test_a_fast_walk_continues_as_fast_as_the_servos_of_the_other_legs_hold_and_no_faster(
    legs: tuple[int, ...], swing_share: float
) -> None:
    """Those of four legs hold no pace: it continues at the robot's."""
    robot = shipped("phantomx")
    fast = fast_gaits(robot, make_gait(robot, "tripod"), heading_rad=0.0)[0]
    failures = [Failure(leg=leg, kind="locked") for leg in legs]
    gait = GlideToStableGait(None).respond(robot, TrialPlan(gait=fast, hold="line"), 0.0, failures).gait
    assert gait is not None
    assert gait.swing_share == swing_share
    assert ideal_speed_m_s(robot, gait, Motion()) <= ideal_speed_m_s(robot, fast, Motion()) + 1e-9
    path = JointPath.of(robot, gait, Motion())
    assert path is not None
    assert path.most_pace_hz > gait.pace_hz or gait.pace_hz == robot.gait.pace_hz
