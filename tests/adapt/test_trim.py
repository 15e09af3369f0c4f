"""Trims: what paths teach of a gait's drift, the search that corrects it, and its sessions."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexctl.adapt.adaptation import AdaptationResult, adapt
from hexctl.adapt.measurement import Answer, measured
from hexctl.adapt.optimizer import Observation, Trim
from hexctl.adapt.optimizers.trim import TrimSearch
from hexctl.adapt.prior.drift import drift_of
from hexctl.adapt.prior.drift_belief import COUPLED, GAIN
from hexctl.adapt.prior.prior import load_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import drift_samples_of
from hexctl.adapt.runner import TrialRequest, TrialRunner, WalkedTrial
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.session_tables import flat_rows
from hexctl.adapt.setting import load_setting
from hexctl.backends.sim.world import World, load_world
from hexctl.control.planning.static_stability import STAND_UP
from hexctl.control.scoring.uncertainty_store import CONFIRM_STEP_S
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from hexctl.testing.optimizer_conformance import ONE_FAILED
from tests.adapt.walking import arc_of, closing_lines
from tests.robots import shipped

CYCLE_S = 1 / 0.9

#: Seconds of a walk of 30 s at full stride.
STEADY_S = 30.0 - RAMP_DURATION_S / 2


pytestmark = pytest.mark.usefixtures("in_an_empty_folder")


class Robot:
    """A made-up robot whose gaits drift, each walk with noise of its own.

    Attributes:
        drift: of all gaits.
        noise_rad: of the course of gaits by their code; others repeat exactly.
        status: of walks of gaits by their code; others are `ok`.
    """

    def __init__(self, drift: Trim, *, gain: float = 0.85) -> None:
        self.drift, self.gain = drift, gain
        self.noise_rad: dict[int, float] = {}
        self.status: dict[int, str] = {}
        self.hold = "none"
        self.walked = 0

    def result(self, code: int, trim: Trim | None) -> TrialResult:
        """Result of the next walk of a gait."""
        self.walked += 1
        noise_rad = self.noise_rad.get(code, 0.0) * (1 if self.walked % 2 else -1)
        drift = replace(self.drift, course_rad=self.drift.course_rad + noise_rad)
        walk = arc_of(drift, trim or Trim(), gain=self.gain, status=self.status.get(code, "ok"))
        if self.hold == "heading":
            walk = replace(walk, hold="heading", turn_trim_rad_s=None)
        return walk if trim is not None else replace(walk, trim_rad=None, turn_trim_rad_s=None)

    def searched(self, search: TrimSearch, walks: int, *, seen_every: int = 1) -> list[tuple[int, float]]:
        """Code and deviation of each walk of a search, which sees every so many ticks of the path."""
        done = []
        unseen = np.arange(1, 1501)[:, np.newaxis] % seen_every > 0
        for _ in range(walks):
            (code,) = search.ask()
            result = self.result(code, search.trim(code))
            off_m = float(abs(result.path_m[-1, 1]))
            seen = replace(result, path_m=np.where(unseen, np.nan, result.path_m))
            search.tell([code], [off_m], [Observation.of(seen)])
            done.append((code, off_m))
        return done


def drift_in(path_m: Any, duration_s: float = 30.0) -> Any:
    observation = Observation(path_m=path_m, duration_s=duration_s, yaw_change_rad=None, status="ok")
    return drift_of(observation, CYCLE_S)


@pytest.mark.parametrize("noise_m", [0.0, 0.01])
def test_an_arc_has_its_course_and_its_turn_whatever_sways(noise_m: float) -> None:
    arc = arc_of(Trim(0.05, 0.02), Trim())
    sway_m = 0.02 * np.sin(math.tau * np.arange(1500) / 1500 * 27)[:, np.newaxis]
    found = drift_in(arc.path_m + sway_m + noise_m * np.random.default_rng(3).normal(size=(1500, 2)))
    assert found.half_turn_rad == pytest.approx(0.02 * STEADY_S / 2, abs=0.005 + noise_m)
    assert found.course_rad == pytest.approx(0.05 + 0.02 * STEADY_S / 2, abs=0.01 + noise_m)
    assert found.distance_m == pytest.approx(4.0, abs=0.2)


def tape(arc: TrialResult, *ticks: int) -> TrialResult:
    """A walk that is measured by a tape at some ticks and at its end."""
    points = [(float(x), float(y)) for x, y in arc.path_m[[*ticks, -1]]]
    answer = Answer(
        word="measured", distance_m=points[-1][0], signed_m=points[-1][1], before_m=tuple(points[:-1])
    )
    setting = load_setting(new_spec(failed_leg=5, prior="none"))
    return measured(arc, answer, setting.robot, setting.plan)


def test_points_of_a_tape_tell_the_turn_and_the_end_alone_an_arc_along_the_line() -> None:
    arc = arc_of(Trim(0.05, 0.02), Trim())
    found = drift_in(tape(arc, 400, 800, 1200).path_m)
    assert found.half_turn_rad == pytest.approx(0.02 * STEADY_S / 2, rel=0.1)
    alone = drift_in(tape(arc).path_m)
    assert alone.half_turn_rad == alone.course_rad == pytest.approx(found.course_rad, abs=0.01)
    assert drift_in(np.full((1500, 2), np.nan)) is None


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(
    course_deg=st.floats(-8, 8),
    turn_deg_s=st.floats(-2.2, 2.2),
    gain=st.floats(0.45, 1.2),
    seen_every=st.sampled_from([1, 500]),
)
def test_the_law_converges_whatever_a_gait_drifts(
    course_deg: float, turn_deg_s: float, gain: float, seen_every: int
) -> None:
    robot = Robot(Trim(math.radians(course_deg), math.radians(turn_deg_s)), gain=gain)
    search = TrimSearch(ONE_FAILED, 0, cycle_s=CYCLE_S)
    code, off_m = robot.searched(search, 6, seen_every=seen_every)[-1]
    assert off_m < 0.05
    assert code == 1, "it stays with a gait that can be straightened"


@pytest.mark.parametrize(
    ("noise_rad", "status", "floor_m", "drift", "walks", "changed"),
    [
        (0.0, "ok", 2.0, Trim(0.02, 0.02), 6, False),
        (0.15, "ok", 2.0, Trim(0.02, 0.02), 6, True),
        (0.0, "fell", 2.0, Trim(0.02, 0.02), 2, True),
        (0.0, "no_progress", 4.1, Trim(0.02, 0.0), 2, True),
        (0.0, "no_progress", 3.8, Trim(0.02, 0.05), 2, False),
        (0.0, "ok", 2.0, Trim(0.0, 0.2), 3, True),
    ],
    ids=["repeats", "does not repeat", "falls", "too slow", "lost in a curve", "beyond the limits"],
)
def test_the_code_changes_if_trimming_it_promises_less(
    noise_rad: float, status: str, floor_m: float, drift: Trim, walks: int, changed: bool
) -> None:
    robot = Robot(drift)
    robot.noise_rad, robot.status = {1: noise_rad}, {1: status}
    codes = [
        code for code, _ in robot.searched(TrimSearch(ONE_FAILED, 0, cycle_s=CYCLE_S, floor_m=floor_m), walks)
    ]
    assert codes[0] == 1
    assert (codes[-1] != 1) == changed


def test_a_prior_names_the_gait_that_drifts_most_surely_and_its_first_trim() -> None:
    samples = drift_samples_of(load_prior(shipped_priors() / "ant-locked-rear-30s.npz"), shipped(), 5)
    search = TrimSearch(ONE_FAILED, 0, samples=samples, cycle_s=CYCLE_S)
    (code,) = search.ask()
    mean_rad = samples.drifts_rad.mean(axis=0)[code - 1]
    spread_rad = samples.drifts_rad[..., 0].std(axis=0)
    assert spread_rad[code - 1] < np.percentile(spread_rad, 10)
    trim = search.trim(code)
    left_rad = mean_rad[1] + COUPLED * trim.course_rad + GAIN * trim.turn_rad_s * STEADY_S / 2
    assert left_rad == pytest.approx(0.0, abs=1e-5)
    assert trim.course_rad == pytest.approx(mean_rad[1] - mean_rad[0], abs=1e-5)
    mirrored = -samples.drifts_rad.mean(axis=0)
    assert np.allclose(np.sort(mirrored[:, 0]), np.sort(samples.drifts_rad.mean(axis=0)[:, 0]), atol=2e-3)


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    """Made-up walks instead of a simulation."""
    made = Robot(Trim(0.03, math.radians(-1.5)))

    def walk(_: TrialRunner, request: TrialRequest) -> WalkedTrial:
        return WalkedTrial(result=made.result(request.code, request.trim))

    monkeypatch.setattr(TrialRunner, "walk", walk)
    return made


def search(**options: Any) -> AdaptationResult:
    return adapt(5, record=False, **{"prior": "none", "baseline": False, **options})


@pytest.mark.usefixtures("robot")
def test_a_session_straightens_one_gait_confirms_it_and_prints_how_to_walk_it() -> None:
    result = search(budget=9)
    session, scores = result.session, [trial.score for trial in result.trials]
    assert (session.spec.optimizer, result.ended) == ("trim", "target")
    assert scores[0] > 1.0 > 0.025 >= scores[-1]
    assert len({trial.code for trial in result.trials}) == 1
    assert not any(trial.confirms for trial in result.trials), "without noise it would end there again"
    best = session.best_walk
    assert best is not None
    words = closing_lines(session, result.ended).splitlines()[-1].split()
    options = dict(zip(words[5::2], words[6::2], strict=True))
    spec = RunSpec(
        failed_leg=5,
        gait=int(options["--gait"]),
        hold="none",
        trim_rad=math.radians(float(options["--trim"])),
        turn_trim_rad_s=math.radians(float(options["--turn-trim"])),
    )
    spec.check()
    plan = plan_walk(spec, shipped())
    assert (plan.trim_rad, plan.turn_trim_rad_s) == (best.trim.course_rad, best.trim.turn_rad_s)
    assert load_world(options["--world"]) == World(time_step_s=CONFIRM_STEP_S)
    row, walked = flat_rows(session)[-1], session.as_json()["trials"][-1]
    assert (
        row["turn_trim_deg_s"]
        == walked["turn_trim_deg_s"]
        == pytest.approx(math.degrees(best.trim.turn_rad_s))
    )


@pytest.mark.parametrize(("target_m", "ended"), [(0.018, "target"), (0.016, "budget")])
def test_a_noisy_walk_within_the_target_has_to_repeat_that_within_the_budget(
    robot: Robot, target_m: float, ended: str
) -> None:
    robot.noise_rad = dict.fromkeys(range(1, 121), 0.004)
    Path("noisy.yaml").write_text("sensor_noise: {position_m: 0.01}", encoding="utf-8")
    result = search(budget=9, target_m=target_m, world="noisy.yaml")
    trials, summary = result.trials, closing_lines(result.session, result.ended)
    again = [trial for trial in trials if trial.confirms]
    for trial in again:
        before = trials[trial.index - 2]
        assert (before.trim, before.score <= target_m) == (trial.trim, True)
    assert (result.ended, again[-1].score <= target_m, len(trials) <= 9) == (ended, ended == "target", True)
    assert f"{len(trials)} trials, {30 * len(trials)} s walked" in summary
    assert f"accuracy: repeated in trial {again[-1].index}; within" in summary or ended == "budget"


def test_a_held_heading_is_trimmed_by_its_course_only(robot: Robot) -> None:
    robot.hold, robot.drift = "heading", Trim(math.radians(2.0), 0.0)
    result = search(hold="heading", budget=3, baseline=True)
    assert len(result.trials) == 1
    assert result.trials[0].outcome["trim_deg"] == pytest.approx(-2.0, abs=0.1)
    assert result.trials[0].outcome["turn_trim_deg_s"] is None
    walk_on = closing_lines(result.session, result.ended).splitlines()[-1]
    assert f"--hold heading --trim {result.trials[0].outcome['trim_deg']:.4f}" in walk_on


def test_a_trimmed_walk_keeps_its_line_and_is_refused_elsewhere() -> None:
    plan = load_setting(new_spec(failed_leg=5)).plan
    assert plan.turn_trim_rad_s is None
    trimmed = replace(plan, turn_trim_rad_s=0.02, trim_rad=0.1)
    motion = trimmed.motion(0.3)
    assert (trimmed.straight, motion.turn_rate_rad_s) == (True, 0.02)
    assert motion.heading_rad == pytest.approx(plan.motion(0.3).heading_rad + 0.1)
    assert replace(plan, turn_trim_rad_s=0.0).motion(0.3) == plan.motion(0.3)
    for wrong in ({"hold": "heading"}, {"turn_rate_rad_s": 0.1}, {"travel": 0.0}):
        with pytest.raises(InputError, match=r"turn.trim"):
            replace(trimmed, **wrong)
    with pytest.raises(InputError, match=r"turn.trim"):
        replace(plan, turn_trim_rad_s=0.1)


@pytest.mark.slow
def test_a_simulated_walk_in_open_loop_is_straightened() -> None:
    result = adapt(
        failure="3:limp",
        world="transfer:202",
        duration_s=15.0,
        prior="none",
        target_m=0.001,
        budget=3,
        baseline=False,
        record=False,
    )
    first_m, *_, last_m = [trial.score for trial in result.trials]
    assert last_m < 0.3 * first_m


@pytest.mark.parametrize(
    ("options", "body_raise"),
    [
        ({"hold": "heading", "self_rotation": "none"}, STAND_UP),
        ({"optimizer": "trim", "self_rotation": "none"}, STAND_UP),
        ({"hold": "heading"}, 0.0),
        ({"trim": "off", "prior": "none", "self_rotation": "none"}, 0.0),
        ({"hold": "heading", "self_rotation": "none", "body_raise": 0.0}, 0.0),
    ],
    ids=["held", "trimmed", "trailing", "of codes", "given"],
)
def test_a_body_stands_up_off_a_locked_leg_that_does_not_trail(
    options: dict[str, Any], body_raise: float
) -> None:
    spec = new_spec(failed_leg=1, **options)
    assert spec.body_raise == body_raise
    assert load_setting(spec).plan.gait.posture.body_raise == body_raise
