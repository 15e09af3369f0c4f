"""Heading trims and turns: what walks teach of a gait's bias, and the sessions that walk with them."""

import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.adaptation import Adaptation, adapt
from hexctl.adapt.adaptation_result import AdaptationResult
from hexctl.adapt.optimizers.trim import (
    WALKS,
    TrimSearch,
    mean_trim_rad,
    mean_turn_trim_rad_s,
    wanted_trim_rad,
    wanted_turn_trim_rad_s,
)
from hexctl.adapt.runner import TrialRunner, WalkedTrial
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.session_tables import flat_rows
from hexctl.adapt.setting import load_setting
from hexctl.control.assessment.static_stability import STAND_UP
from hexctl.control.trial_plan import MAX_TRIM_RAD, MAX_TURN_TRIM_RAD_S
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import AUTO
from hexctl.testing.optimizer_conformance import ONE_FAILED, Make, OptimizerConformance
from tests.adapt.walking import closing_lines, result_of

#: How far a made-up gait walks, and its drift aside.
WAY_M = 4.0

DRIFT_RAD = math.radians(2.0)

#: Of the end of a made-up walk.
NOISE_M = 0.02


class TestTrimSearch(OptimizerConformance):
    seeded = False

    @pytest.fixture
    def make(self) -> Make:
        return TrimSearch


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def ended(
    angle_rad: float, *, trim_rad: float | None, status: str = "ok", noise_m: float = 0.0
) -> TrialResult:
    """The result of a walk that drifts aside at an angle."""
    signed_m = WAY_M * math.tan(angle_rad) + noise_m
    hold = "none" if trim_rad is None else "heading"
    return replace(result_of(signed_m, status), hold=hold, trim_rad=trim_rad)


class Drifting:
    """Walks whose gaits all drift aside alike, each end with noise of its own.

    In open loop they curve instead, and a turn is a tenth weaker than it is commanded.

    Attributes:
        status: of walks by their code; others are `ok`.
        caveat: why they hold less than they should, or None.
        hold: what walks hold.
        drift_rad: how far they drift aside.
        curve_rad_s: how fast they turn in open loop.
    """

    def __init__(self) -> None:
        self.status: dict[int, str] = {}
        self.caveat: str | None = None
        self.hold, self.drift_rad, self.curve_rad_s = "heading", DRIFT_RAD, math.radians(-1.5)

    def walk(self, runner: TrialRunner, index: int, code: int, slots: Slots) -> WalkedTrial:
        """Walk a gait with the trim of its plan, as far as what is held allows."""
        plan = runner.plan_for(slots)
        trim_rad = plan.trim_rad if self.hold == "heading" else None
        angle_rad, noise_m = self.drift_rad + (trim_rad or 0.0), NOISE_M * math.sin(1.7 * index)
        if plan.turn_trim_rad_s is not None:
            angle_rad = (self.curve_rad_s + 0.9 * plan.turn_trim_rad_s) * plan.duration_s / 2
        status = self.status.get(code, "ok")
        result = ended(angle_rad, trim_rad=trim_rad, status=status, noise_m=noise_m)
        return WalkedTrial(
            result=replace(result, turn_trim_rad_s=plan.turn_trim_rad_s, hold_caveat=self.caveat)
        )


@pytest.fixture
def drifting(monkeypatch: pytest.MonkeyPatch) -> Drifting:
    """Made-up walks instead of a simulation."""
    made = Drifting()
    monkeypatch.setattr(TrialRunner, "walk", lambda runner, *trial: made.walk(runner, *trial[:3]))
    return made


def search(**options: Any) -> AdaptationResult:
    return adapt(5, record=False, **{"hold": "heading", "baseline": False, **options})


def test_a_walk_wants_what_would_have_ended_it_on_its_line() -> None:
    drifted = ended(DRIFT_RAD, trim_rad=0.01)
    # The mean over the last second is a little short of the end, and on the same straight way.
    assert wanted_trim_rad(drifted) == pytest.approx(0.01 - DRIFT_RAD)
    assert wanted_trim_rad(ended(DRIFT_RAD, trim_rad=None)) is None, "it held no heading"
    assert wanted_trim_rad(ended(DRIFT_RAD, trim_rad=0.01, status="no_progress")) is None
    by_tape = np.full((1500, 2), np.nan)
    by_tape[-1] = 4.1, -0.12
    measured = replace(drifted, path_m=by_tape)
    assert wanted_trim_rad(measured) == pytest.approx(0.01 + math.atan2(0.12, 4.1))
    assert wanted_trim_rad(replace(drifted, path_m=-by_tape)) is None, "it went backward"


def test_the_trim_of_a_gait_is_the_mean_and_within_what_a_plan_takes() -> None:
    assert mean_trim_rad([]) == 0.0
    assert mean_trim_rad([0.01, 0.03]) == pytest.approx(0.02)
    assert mean_trim_rad([2.0]) == MAX_TRIM_RAD
    assert mean_trim_rad([-2.0]) == -MAX_TRIM_RAD


def test_one_gait_is_walked_until_it_fails_then_the_next() -> None:
    trim = TrimSearch(ONE_FAILED, 0, codes=[7, *range(1, 7), *range(8, 121)])
    walked = []
    for score in itertools.chain([0.1] * WALKS, [1e6], [0.1]):
        walked += trim.ask()
        trim.tell(walked[-1:], [score])
    assert walked == [7] * WALKS + [1, 2]
    with pytest.raises(InputError, match="trim"):
        TrimSearch(ONE_FAILED, 0, codes=[1, 2])


@pytest.mark.usefixtures("drifting")
def test_the_trim_is_the_mean_of_all_walks_of_the_gait_and_of_no_other() -> None:
    result = search(target_m=1e-6, budget=WALKS + 2)
    trials = result.trials
    for trial in trials:
        wanted = [one.wanted_trim_deg for one in trials[: trial.index - 1] if one.code == trial.code]
        assert trial.outcome["trim_deg"] == pytest.approx(
            np.mean(np.array(wanted, dtype=float)) if wanted else 0.0
        )
    assert len({trial.code for trial in trials}) == 2
    assert trials[WALKS].outcome["trim_deg"] == 0.0, "another gait has a bias of its own"
    errors_deg = [abs(trial.outcome["trim_deg"] + math.degrees(DRIFT_RAD)) for trial in trials[:WALKS]]
    assert errors_deg[WALKS - 1] < errors_deg[1], "more walks know the bias better"


@pytest.mark.usefixtures("drifting")
def test_the_baseline_teaches_the_first_trial() -> None:
    result = search(baseline=True)
    auto = next(walk for walk in result.baseline if walk.gait == AUTO)
    assert result.trials[0].slots == auto.slots
    assert result.trials[0].outcome["trim_deg"] == pytest.approx(auto.wanted_trim_deg)
    assert (result.ended, len(result.trials)) == ("target", 1)


def test_an_invalid_walk_teaches_nothing_and_another_gait_is_next(drifting: Drifting) -> None:
    first = search(budget=1, target_m=1e-6).trials[0].code
    drifting.status = {first: "fell"}
    trials = search(budget=3).trials
    assert [trial.wanted_trim_deg is None for trial in trials] == [True, False, False]
    assert trials[0].code == first
    assert trials[1].code == trials[2].code != first
    assert trials[1].outcome["trim_deg"] == 0.0


def test_a_robot_that_holds_nothing_learns_nothing(drifting: Drifting) -> None:
    drifting.hold = "none"
    drifting.caveat = "no yaw was measured"
    result = search(budget=2)
    assert [trial.outcome["trim_deg"] for trial in result.trials] == [None, None]
    assert result.session.best_trim_deg is None
    lines = closing_lines(result.session, result.ended).splitlines()
    (said,) = [
        line for line in lines if line.startswith("walks held less than heading: no yaw was measured;")
    ]
    assert said.endswith("--optimizer trim --hold none learns a turn from the ends alone")
    assert not any(line.startswith("walk on with") for line in lines)


def test_a_walk_in_open_loop_wants_a_turn_against_its_curve() -> None:
    curved = replace(ended(0.2, trim_rad=None), turn_trim_rad_s=0.01)
    assert wanted_turn_trim_rad_s(curved) == pytest.approx(0.01 - 2 * 0.2 / 30.0)
    assert wanted_turn_trim_rad_s(replace(curved, status="fell")) is None
    assert wanted_turn_trim_rad_s(replace(curved, turn_trim_rad_s=None)) is None, "it is not asked for"
    assert wanted_trim_rad(curved) is None


def test_far_off_walks_count_little_for_the_turn_and_near_ones_alike() -> None:
    assert mean_turn_trim_rad_s([]) == 0.0
    assert mean_turn_trim_rad_s([(0.0, 9.0, 30.0)]) == MAX_TURN_TRIM_RAD_S
    far, near = (0.0, 0.030, 30.0), (0.030, 0.033, 30.0)
    assert mean_turn_trim_rad_s([far, near]) == pytest.approx(0.033, abs=0.0003)
    one, other = (0.033, 0.0332, 30.0), (0.033, 0.0328, 30.0)
    assert mean_turn_trim_rad_s([one, other]) == pytest.approx(0.033)


def test_a_session_in_open_loop_learns_a_turn_where_it_is_asked_to(drifting: Drifting) -> None:
    drifting.hold = "none"
    whole = search(hold="none", optimizer="trim", budget=4, target_m=0.001)
    ends_m = [trial.score for trial in whole.trials]
    assert ends_m[0] > 1.0
    assert max(ends_m[2:]) < 2 * NOISE_M
    (code,) = {trial.code for trial in whole.trials}
    turned = [trial.outcome["turn_trim_deg_s"] for trial in whole.trials]
    assert turned[0] == 0.0
    assert turned[1] == pytest.approx(whole.trials[0].wanted_turn_trim_deg_s)
    assert whole.session.best_turn_trim_deg_s == pytest.approx(1.5 / 0.9, rel=0.05)
    last = closing_lines(whole.session, whole.ended).splitlines()[-1]
    turn = f"--turn {whole.session.best_turn_trim_deg_s:.3f}"
    assert last.startswith(
        f"walk on with: hexctl run --failed-leg 5 --gait {code} --hold none --heading 0 {turn}"
    )
    part = search(hold="none", optimizer="trim", budget=2, target_m=0.001)
    assert Adaptation.resume(part.session.name, budget=4, record=False).run().trials == whole.trials


def test_a_trimmed_turn_leaves_the_line_straight_and_is_refused_elsewhere() -> None:
    plan = load_setting(new_spec(failed_leg=5)).plan
    assert plan.turn_trim_rad_s is None
    trimmed = replace(plan, turn_trim_rad_s=0.02)
    assert (trimmed.straight, trimmed.motion(0.0).turn_rate_rad_s) == (True, 0.02)
    assert replace(plan, turn_trim_rad_s=0.0).motion(0.3) == plan.motion(0.3)
    for wrong in ({"hold": "heading"}, {"turn_rate_rad_s": 0.1}, {"travel": 0.0}):
        with pytest.raises(InputError, match="turn trim"):
            replace(trimmed, **wrong)
    with pytest.raises(InputError, match="turn trim"):
        replace(plan, turn_trim_rad_s=0.1)


@pytest.mark.slow
def test_a_simulated_walk_in_open_loop_is_straightened_by_its_ends_alone() -> None:
    result = adapt(
        failure="3:limp",
        world="transfer:202",
        optimizer="trim",
        duration_s=15.0,
        target_m=0.001,
        budget=3,
        baseline=False,
        record=False,
    )
    assert result.session.spec.hold == "none"
    first_m, *_, last_m = [trial.score for trial in result.trials]
    assert last_m < 0.3 * first_m


@pytest.mark.usefixtures("drifting")
def test_trims_are_in_json_and_in_exports() -> None:
    session = search(budget=1, target_m=1.0).session
    (trial,) = session.trials
    (row,) = flat_rows(session)
    outcome = session.as_json()
    assert row["trim_deg"] == trial.outcome["trim_deg"]
    assert row["wanted_trim_deg"] == outcome["trials"][0]["wanted_trim_deg"] == trial.wanted_trim_deg
    assert outcome["best_trim_deg"] == session.best_trim_deg
    walk_on = closing_lines(session, "budget").splitlines()[-1]
    assert f"--gait {trial.code} --hold heading --trim {session.best_trim_deg:.2f}" in walk_on


@pytest.mark.parametrize(
    ("options", "body_raise"),
    [
        ({"hold": "heading", "self_rotation": "none"}, STAND_UP),
        ({"optimizer": "trim", "self_rotation": "none"}, STAND_UP),
        ({"hold": "heading"}, 0.0),
        ({"prior": "none", "self_rotation": "none"}, 0.0),
        ({"hold": "heading", "self_rotation": "none", "body_raise": 0.0}, 0.0),
    ],
    ids=["held", "trimmed", "trailing", "open loop", "given"],
)
def test_a_body_stands_up_off_a_locked_leg_that_does_not_trail(
    options: dict[str, Any], body_raise: float
) -> None:
    spec = new_spec(failed_leg=1, **options)
    assert spec.body_raise == body_raise
    assert load_setting(spec).plan.gait.posture.body_raise == body_raise


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"hold": "line"}, "optimizer"),
        ({"hold": "auto"}, "optimizer"),
        ({"hold": "heading", "objective": "speed"}, "optimizer"),
        ({"objective": "speed"}, "optimizer"),
        ({"hold": "heading", "count_repeats": True}, "optimizer"),
        ({"hold": "heading", "early_stop": True}, "early_stop"),
        ({"hold": "heading", "prior": "auto"}, "prior"),
    ],
    ids=str,
)
def test_what_does_not_go_with_a_trim_is_refused(options: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError, match=field):
        new_spec(failed_leg=5, optimizer="trim", **options)
