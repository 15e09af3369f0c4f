"""What a repertoire has for failures and directions, and its files."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl import Failure, InputError, TrialPlan, make_gait
from hexctl.archive import ArchiveFileError
from hexctl.control.body_symmetry import IDENTITY
from hexctl.control.monitor.repertoire import Candidate, Situation
from hexctl.control.monitor.repertoire_store import (
    describe_repertoire,
    find_repertoire,
    load_repertoire,
    repertoire_files,
    save_repertoire,
)
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
from tests.robots import shipped

STUCK = (Failure(leg=2, kind="stuck", joint="femur"),)


def test_a_failure_is_looked_up_by_leg_kind_and_joint() -> None:
    repertoire = made_up()
    found = repertoire.choice(STUCK, 0.0)
    assert found is not None
    assert (found.candidate, found.walks) == (ON, 4)
    assert found.gain == pytest.approx(0.205)
    gone = repertoire.choice((Failure(leg=2, kind="missing"),), 0.0)
    assert gone is not None
    assert gone.candidate == OTHER
    for other in (
        Failure(leg=3, kind="stuck", joint="femur"),
        Failure(leg=2, kind="stuck", joint="tibia"),
        Failure(leg=2, kind="limp", joint="femur"),
    ):
        assert repertoire.choice((other,), 0.0) is None
    assert repertoire.choice((*STUCK, Failure(leg=3)), 0.0) is None
    assert repertoire.choice((), 0.0) is None
    assert repertoire.choice((replace(STUCK[0], angle_rad=0.3),), 0.0) is not None
    assert replace(repertoire, situations=()).choice(STUCK, 0.0) is None


@pytest.mark.parametrize(
    ("heading_deg", "covered"), [(14.0, True), (-14.0, True), (346.0, True), (16.0, False), (180.0, False)]
)
def test_the_nearest_direction_counts_and_those_beyond_half_a_step_are_others(
    heading_deg: float, covered: bool
) -> None:
    assert (made_up(ON_IS_BEST).choice(STUCK, math.radians(heading_deg)) is not None) == covered


def test_alike_situations_share_what_one_has_walked() -> None:
    repertoire = made_up(OTHER_IS_BEST, symmetries=(IDENTITY, MIRROR, TURN))
    there = repertoire.choice((Failure(leg=2, kind="missing"),), 0.0)
    mirrored = repertoire.choice((Failure(leg=6, kind="missing"),), 0.0)
    turned = repertoire.choice((Failure(leg=1, kind="missing"),), math.radians(-60.0))
    assert there is not None
    assert mirrored is not None
    assert turned is not None
    assert there.candidate == OTHER
    assert mirrored.candidate.tucked_legs == (6,)
    assert mirrored.candidate.slots == (2, 6, 5, 4, 3, 1)
    assert mirrored.candidate.shift == (0.02, -0.03)
    assert turned.candidate.tucked_legs == (1,)
    assert turned.candidate.slots == (1, 3, 4, 5, 6, 2)
    assert np.linalg.norm(turned.candidate.shift) == pytest.approx(np.hypot(0.02, 0.03), abs=1e-6)
    assert math.degrees(math.atan2(*turned.candidate.shift[::-1])) == pytest.approx(56.31 - 60, abs=0.01)
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
    repertoire, plan = made_up(), TrialPlan(gait=make_gait(shipped(), "tripod"), hold="line")
    nearly = TrialPlan(gait=make_gait(shipped(), "wave", pace_hz=0.8), hold="auto")
    assert repertoire.covers(shipped(), plan)
    assert repertoire.covers(shipped(), nearly)
    others = [
        replace(plan, hold="none"),
        replace(plan, turn_rate_rad_s=0.1),
        replace(plan, travel=0.0),
        replace(plan, belief=Failure(leg=5)),
        replace(plan, gait=replace(plan.gait, pace_hz=0.7)),
        replace(plan, gait=replace(plan.gait, amplitude=0.08)),
        replace(plan, gait=replace(plan.gait, height=0.05)),
        replace(plan, gait=replace(plan.gait, posture=Posture(body_raise=0.02))),
        replace(plan, gait=replace(plan.gait, swing_share=0.25)),
    ]
    assert not any(repertoire.covers(shipped(), other) for other in others)
    pexod = TrialPlan(gait=make_gait(shipped("pexod"), "tripod"), hold="line")
    assert not repertoire.covers(shipped("pexod"), pexod)


PLAN = TrialPlan(gait=make_gait(shipped(), "tripod"), hold="line")


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    repertoire = made_up(with_fall(ON_IS_BEST, 2), symmetries=(IDENTITY, MIRROR))
    path = tmp_path / "deep" / "ant.npz"
    save_repertoire(repertoire, path)
    loaded = load_repertoire(path)
    assert loaded.digest() == repertoire.digest()
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
