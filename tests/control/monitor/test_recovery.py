"""What recoveries decide, and the repertoires that they look into."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl import Failure, InputError, TrialPlan, make_gait
from hexctl.archive import ArchiveFileError
from hexctl.control.body_symmetry import IDENTITY
from hexctl.control.monitor import recovery
from hexctl.control.monitor.posture_trial import MOST_HASTE, REPORTED_RISE, PostureTrial
from hexctl.control.monitor.recovery import GlideToStableGait, Response, StopWalking, WalkOn
from hexctl.control.monitor.repertoire import (
    Candidate,
    Situation,
    describe_repertoire,
    find_repertoire,
    load_repertoire,
    repertoire_files,
    save_repertoire,
)
from hexctl.control.planning import crawl
from hexctl.control.planning.crawl import CRAWL_SWING
from hexctl.control.planning.top_speed import JointPath, fast_gaits
from hexctl.control.trial_plan import Hold
from hexctl.gait.gait import Motion, ideal_speed_m_s
from hexctl.gait.posture import Posture
from hexctl.robot.configs import config_root
from tests.control.monitor.repertoires import (
    MIRROR,
    ON,
    ON_IS_BEST,
    OTHER,
    OTHER_IS_BEST,
    SAFE,
    TURN,
    made_up,
    situation,
    with_fall,
)
from tests.robots import ROBOT_NAMES, shipped


def _plan(name: str = "ant") -> TrialPlan:
    return TrialPlan(gait=make_gait(shipped(name), "tripod"), hold="line")


STUCK = Failure(leg=2, kind="stuck", joint="femur")


def test_nothing_a_stop_and_the_plan_once_all_legs_are_whole() -> None:
    glide, plan = GlideToStableGait(), _plan()
    assert WalkOn().respond(shipped(), plan, 0.0, (Failure(leg=2),)) == Response()
    assert StopWalking().respond(shipped(), plan, 0.0, (Failure(leg=2),)) == Response(stop=True)
    assert glide.respond(shipped(), plan, 0.0, ()) == Response(gait=plan.gait)
    without_three = [Failure(leg=leg, kind="limp") for leg in (1, 3, 5)]
    assert glide.respond(shipped(), plan, 0.0, without_three) == Response(stop=True)


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("legs", [(1,), (2, 5)])
def test_failed_legs_are_tucked_and_the_others_walk_a_gait_of_their_own(
    name: str, legs: tuple[int, ...]
) -> None:
    glide, plan = GlideToStableGait(), _plan(name)
    response = glide.respond(shipped(name), plan, 0.0, [Failure(leg=leg) for leg in legs])
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
    assert [1.0, *told][-1] == pytest.approx(haste, abs=REPORTED_RISE)


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
    glide, plan = GlideToStableGait(), _plan()
    glide.prepare(shipped(), plan, 0.5)
    known = crawl._gait_without.cache_info().misses
    for leg in range(1, 7):
        glide.respond(shipped(), plan, 0.5, [Failure(leg=leg, kind="locked")])
        glide.respond(shipped(), plan, 0.5, [Failure(leg=leg), Failure(leg=leg % 6 + 1)])
    assert crawl._gait_without.cache_info().misses == known


@pytest.mark.parametrize(
    ("gait", "failure", "chosen", "did"),
    [
        ("tripod", STUCK, "tripod", "walked on: 20%"),
        ("wave", STUCK, "tripod", "changed to slots 1,4,1,4,1,4: 20%"),
        ("wave", Failure(leg=2, kind="missing"), None, "changed to slots 2,1,3,4,5,6: 13%"),
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
    glide, unprepared, without = GlideToStableGait(), GlideToStableGait(), GlideToStableGait(None)
    for prepared in (glide, without):
        prepared.prepare(shipped(), _plan(), 0.0)
    monkeypatch.setattr(recovery, "find_repertoire", None)
    assert glide.respond(shipped(), _plan(), 0.0, [STUCK]).stays
    for other in (unprepared, without):
        assert not other.respond(shipped(), _plan(), 0.0, [STUCK]).stays


@pytest.mark.parametrize(("held_hz", "walked_hz"), [((9.0, 0.2), None), ((0.7, 0.2), 0.7), ((), 0.5)])
def test_without_a_leg_a_fast_walk_has_the_pace_that_the_servos_hold_if_it_is_no_faster_than_before(
    held_hz: tuple[float, ...], walked_hz: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = replace(shipped(), gait=replace(shipped().gait, pace_hz=0.5))
    held = lambda _, gait, **__: tuple(replace(gait, pace_hz=pace_hz) for pace_hz in held_hz)  # noqa: E731
    monkeypatch.setattr(recovery, "fast_gaits", held)
    fast = make_gait(robot, "tripod", pace_hz=1.2)
    plan = TrialPlan(gait=fast, hold="line")
    gait = GlideToStableGait(None).respond(robot, plan, 0.0, [Failure(leg=2)]).gait
    assert gait is not None
    if walked_hz is None:
        assert ideal_speed_m_s(robot, gait, Motion()) == pytest.approx(ideal_speed_m_s(robot, fast, Motion()))
    else:
        assert gait.pace_hz == walked_hz


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


# What a repertoire has for failures and directions, and its files


PLAN = TrialPlan(gait=make_gait(shipped(), "tripod"), hold="line")


def test_a_failure_is_looked_up_by_leg_kind_and_joint() -> None:
    repertoire = made_up()
    found = repertoire.choice([STUCK], 0.0)
    assert found is not None
    assert (found.candidate, found.walks) == (ON, 4)
    assert found.gain == pytest.approx(0.205)
    for other in (
        Failure(leg=3, kind="stuck", joint="femur"),
        Failure(leg=2, kind="stuck", joint="tibia"),
        Failure(leg=2, kind="limp", joint="femur"),
    ):
        assert repertoire.choice((other,), 0.0) is None
    assert repertoire.choice((STUCK, Failure(leg=3)), 0.0) is None
    assert repertoire.choice((), 0.0) is None
    assert repertoire.choice((replace(STUCK, angle_rad=0.3),), 0.0) is not None
    assert replace(repertoire, situations=()).choice([STUCK], 0.0) is None


@pytest.mark.parametrize(
    ("heading_deg", "covered"), [(14.0, True), (-14.0, True), (346.0, True), (16.0, False), (180.0, False)]
)
def test_the_nearest_direction_counts_and_those_beyond_half_a_step_are_others(
    heading_deg: float, covered: bool
) -> None:
    assert (made_up(ON_IS_BEST).choice([STUCK], math.radians(heading_deg)) is not None) == covered


def test_alike_situations_share_what_one_has_walked() -> None:
    repertoire = made_up(OTHER_IS_BEST, symmetries=(IDENTITY, MIRROR, TURN))
    chosen: list[Candidate] = []
    for leg, heading_deg in ((2, 0.0), (6, 0.0), (1, -60.0)):
        choice = repertoire.choice((Failure(leg=leg, kind="missing"),), math.radians(heading_deg))
        assert choice is not None
        chosen.append(choice.candidate)
    there, mirrored, turned = chosen
    assert there == OTHER
    assert (mirrored.tucked_legs, mirrored.slots) == ((6,), (2, 6, 5, 4, 3, 1))
    assert mirrored.shift == (0.02, -0.03)
    assert (turned.tucked_legs, turned.slots) == ((1,), (1, 3, 4, 5, 6, 2))
    assert np.linalg.norm(turned.shift) == pytest.approx(np.hypot(0.02, 0.03), abs=1e-6)
    assert math.degrees(math.atan2(*turned.shift[::-1])) == pytest.approx(56.31 - 60, abs=0.01)
    assert repertoire.choice((Failure(leg=1, kind="missing"),), 0.0) is None


@pytest.mark.parametrize(
    ("changed", "best"),
    [
        (ON_IS_BEST, ON),
        (with_fall(ON_IS_BEST, 1), SAFE),  # what fell more often is not better
        (with_fall(ON_IS_BEST, 0), ON),
        (situation([[0.7, 0.7, 0.7], [0.9, 0.5, 0.9], [0.7, 0.7, 0.7]]), SAFE),  # noise
        (situation([[0.7, 0.7, 0.7], [0.71, 0.71, 0.71], [0.7, 0.7, 0.7]]), SAFE),  # a percent
        (situation([[0.5, 0.5, 0.5], [0.6, 0.9, 0.9], [0.7, 0.7, 0.7]]), OTHER),  # the surest of several
        (situation([[0.7], [0.9], [0.8]]), SAFE),  # one walk says nothing of the noise
        (situation([[0.7, 0.5], [0.9, 0.7], [0.6, 0.6]]), ON),  # worlds differ, the gain does not
    ],
)
def test_another_gait_is_better_beyond_the_noise_only(changed: Situation, best: object) -> None:
    assert _best(changed) == best


def test_situations_of_one_kind_speak_for_each_other() -> None:
    """Walking on is faster in each, which one alone does not show."""
    noisy = [
        situation([[0.6, 0.6, 0.6], [0.9, 0.5, 1.0], [0.6, 0.6, 0.6]], heading_deg=0.0),
        situation([[0.6, 0.6, 0.6], [0.55, 0.95, 0.8], [0.6, 0.6, 0.6]], heading_deg=30.0),
        situation([[0.6, 0.6, 0.6], [0.8, 0.9, 0.6], [0.6, 0.6, 0.6]], heading_deg=60.0),
    ]
    assert [_best(one) for one in noisy] == [SAFE] * 3
    assert made_up(*noisy).best == (1, 1, 1)


def test_situations_that_differ_and_pairs_are_judged_each_by_itself() -> None:
    one = situation([[0.6, 0.6, 0.6], [0.9, 0.9, 0.91], [0.6, 0.6, 0.6]], heading_deg=0.0)
    other = situation([[0.6, 0.6, 0.6], [0.2, 0.2, 0.21], [0.6, 0.6, 0.6]], heading_deg=30.0)
    assert made_up(one, other).best == (1, 0)
    failed = ((2, "limp", None), (3, "limp", None))
    sure = situation([[0.6, 0.6], [0.9, 0.9], [0.6, 0.6]], failed, 0.0)
    slower = [situation([[0.6, 0.6], [0.5, 0.51], [0.6, 0.6]], failed, 30.0 * k) for k in range(1, 6)]
    assert made_up(sure, *slower).best == (1, 0, 0, 0, 0, 0)


def _best(one: Situation) -> Candidate:
    """Best candidate of a situation by itself."""
    return one.candidates[made_up(one).best[0]]


def test_walks_of_another_sort_and_of_other_robots_are_not_covered() -> None:
    repertoire, plan = made_up(), PLAN
    nearly = TrialPlan(gait=make_gait(shipped(), "wave", pace_hz=0.8), hold="auto")
    assert repertoire.covers(shipped(), plan)
    assert repertoire.covers(shipped(), nearly)
    others = [
        replace(plan, hold="none"),
        replace(plan, turn_rate_rad_s=0.1),
        replace(plan, travel=0.0),
        replace(plan, failures=(Failure(leg=5),)),
        replace(plan, gait=replace(plan.gait, pace_hz=0.7)),
        replace(plan, gait=replace(plan.gait, amplitude=0.08)),
        replace(plan, gait=replace(plan.gait, height=0.05)),
        replace(plan, gait=replace(plan.gait, posture=Posture(body_raise=0.02))),
        replace(plan, gait=replace(plan.gait, swing_share=0.25)),
    ]
    assert not any(repertoire.covers(shipped(), other) for other in others)
    pexod = TrialPlan(gait=make_gait(shipped("pexod"), "tripod"), hold="line")
    assert not repertoire.covers(shipped("pexod"), pexod)


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    repertoire = made_up(with_fall(ON_IS_BEST, 2), symmetries=(IDENTITY, MIRROR))
    path = tmp_path / "deep" / "ant.npz"
    save_repertoire(repertoire, path)
    loaded = load_repertoire(path)
    assert loaded.digest == repertoire.digest
    assert loaded.head == repertoire.head
    assert loaded.symmetries == repertoire.symmetries
    (one,), (before,) = loaded.situations, repertoire.situations
    assert one.candidates == before.candidates
    assert one.failed == before.failed
    np.testing.assert_array_equal(one.speeds, before.speeds)
    np.testing.assert_array_equal(one.costs, before.costs)
    assert (one.walks, one.valid.tolist()) == (4, [1.0, 1.0, 0.75])


def test_what_is_no_whole_repertoire_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    with pytest.raises(InputError):
        load_repertoire(path)
    save_repertoire(made_up(), path)
    content = path.read_bytes()
    for bad in (b"", b"my diary", content[:-60]):
        path.write_bytes(bad)
        with pytest.raises(InputError, match="repertoire"):
            load_repertoire(path)
    path.write_bytes(content)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    head = json.loads(str(arrays["head"]))
    for change in ({"version": 9}, {"pace_hz": 2.0}, {"format": "hexctl prior"}):
        np.savez(path, **arrays | {"head": np.array(json.dumps(head | change))})
        with pytest.raises(InputError):
            load_repertoire(path)
    (tmp_path / "a-file").touch()
    with pytest.raises(ArchiveFileError):
        save_repertoire(made_up(), tmp_path / "a-file" / "x.npz")


def test_one_that_was_built_is_found_before_the_shipped_one(tmp_path: Path) -> None:
    path = tmp_path / "repertoires" / "mine.npz"
    save_repertoire(made_up(), path)
    (path.parent / "damaged.npz").write_bytes(b"my diary")
    found = find_repertoire(shipped(), PLAN, tmp_path)
    assert found is not None
    assert found.origin == {"by": "hand"}
    save_repertoire(replace(made_up(), pace_hz=0.2), path)
    other = find_repertoire(shipped(), PLAN, tmp_path)
    assert other is None or other.origin != {"by": "hand"}


@pytest.mark.parametrize("path", sorted((config_root() / "repertoires").glob("*.npz")), ids=lambda p: p.stem)
def test_shipped_repertoires_are_small_and_of_the_robots_that_are_shipped(path: Path) -> None:
    robot = shipped(path.stem)
    repertoire = load_repertoire(path)
    assert path.stat().st_size < 200_000
    assert repertoire.covers(robot, TrialPlan(gait=make_gait(robot, "tripod"), hold="line"))
    assert path in repertoire_files()
    described = describe_repertoire(path)
    assert described["walks"] >= 4
    assert {"locked", "limp", "missing", "stuck:coxa", "limp:tibia"} <= set(described["legs"])
    assert 0 < described["others"] < described["situations"]
