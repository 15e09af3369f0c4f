"""What is drawn about a walk: gait diagram, ribbon, support polygon, centre of gravity, guard and events."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.log import COLUMN_NAMES, TickLog
from hexctl.control.trace import PHASES
from hexctl.control.trial import run_trial
from hexctl.gait.foot_trajectory import gait_feet_body
from hexctl.ik.legs import foot_positions_body
from hexctl.ik.support_polygon import centre_of_mass_body, support, to_world
from hexctl.recording import paths, style
from hexctl.recording.recording import Recording
from tests.recording.conftest import ReadBack, Trial, make_plan, write
from tests.robots import shipped

WALK = PHASES.index("walk")


@pytest.fixture(scope="module")
def read(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> ReadBack:
    return ReadBack(write(tmp_path_factory.mktemp("drawn") / "trial.rrd", trial))


def rewritten(trial: Trial, **columns: np.ndarray) -> TickLog:
    """The trial's log with other columns."""
    log = TickLog()
    log.frame = trial.log.frame
    log.extend({name: columns.get(name, trial.log[name]) for name in COLUMN_NAMES})
    return log


def recorded(trial: Trial, log: TickLog, path: Path) -> ReadBack:
    return ReadBack(write(path, replace(trial, log=log)))


def lane(read: ReadBack, path: str, ticks: int) -> list[str]:
    """The state at each tick."""
    at = np.round(read.times_s(f"/{path}", "StateChange:state") * 50).astype(int)
    states = [value[0] for value in read.values(f"/{path}", "StateChange:state")]
    rows = np.searchsorted(at, np.arange(ticks), side="right") - 1
    return [states[row] for row in rows]


def commanded_swing(trial: Trial) -> np.ndarray:
    """Which feet the gait of the walk has in the air at each tick of it, (ticks, 6)."""
    log, plan, robot = trial.log, trial.plan, trial.robot
    ticks = np.count_nonzero(log["phase"] == WALK)
    feet = gait_feet_body(robot, plan.gait, plan.motion(trial.result.turned_rad), np.arange(ticks) * 0.02)
    swing = np.asarray(feet[..., 2] > robot.stance_feet_body[:, 2] + 1e-5)
    swing[:, [leg - 1 for leg in plan.held_legs]] = False
    return swing


def test_the_gait_diagram_says_what_is_commanded_and_what_else_is_felt(read: ReadBack, trial: Trial) -> None:
    """A foot that does something else for a tenth of a second is told, one that rattles is not."""
    log = trial.log
    swing, touching = commanded_swing(trial), log["foot_contacts"][log["phase"] == WALK]
    for leg in range(1, 7):
        drawn = np.array(lane(read, paths.gait_path(leg), len(log)))[log["phase"] == WALK]
        np.testing.assert_array_equal(np.isin(drawn, [style.SWING, style.DRAGS]), swing[:, leg - 1])
        other = (swing == touching)[:, leg - 1]
        for row in range(4, len(other)):
            told = drawn[row] in (style.HANGS, style.DRAGS)
            assert told == other[row - 4 : row + 1].all()


def test_without_contacts_the_gait_diagram_is_as_commanded(trial: Trial, tmp_path: Path) -> None:
    log = rewritten(trial)
    log.contacts_known = False
    read = recorded(trial, log, tmp_path / "unfelt.rrd")
    drawn = np.array(lane(read, paths.gait_path(2), len(log)))[log["phase"] == WALK]
    np.testing.assert_array_equal(drawn == style.SWING, commanded_swing(trial)[:, 1])
    assert set(drawn) == {style.STANCE, style.SWING}
    assert read.values(f"/{paths.foot_path(2)}", "Points3D:colors")[0] == [style.packed(style.UNFELT_COLOR)]


def test_polygon_and_centre_of_gravity_are_those_of_the_measured_robot(read: ReadBack, trial: Trial) -> None:
    log, robot = trial.log, trial.robot
    rows = np.arange(0, len(log), 5)
    pose = log["base_position_world"][rows], log["base_quaternion_world"][rows]
    joints = log["measured_rad"][rows]
    feet = to_world(foot_positions_body(robot, joints), *pose)[..., :2]
    centre = to_world(centre_of_mass_body(robot, joints)[:, np.newaxis], *pose)[:, 0]
    found = support(feet, log["foot_contacts"][rows], centre[:, :2])
    drawn = np.array(read.values(f"/{paths.POLYGON}", "Mesh3D:vertex_positions"))
    np.testing.assert_allclose(drawn[..., :2], found.corners, atol=1e-3)
    lines = np.array(read.values(f"/{paths.CENTRE}", "LineStrips3D:strips"))[:, 0]
    np.testing.assert_allclose(lines[:, 1], centre, atol=1e-3)
    np.testing.assert_allclose(lines[:, 0, :2], centre[:, :2], atol=1e-3)
    colors = [value[0] for value in read.values(f"/{paths.CENTRE}", "Points3D:colors")]
    steady, unsteady = (style.packed(color) for color in (style.STEADY_COLOR, style.UNSTEADY_COLOR))
    assert colors == [steady if margin > 0 else unsteady for margin in found.margin_m]


def test_the_margin_is_negative_where_the_centre_is_outside(read: ReadBack) -> None:
    margins = [value[0] for value in read.values(f"/{paths.MARGIN}", "Scalars:scalars")]
    assert min(margins) < 0 < max(margins) < shipped().stance_radius_m


def test_stability_is_the_share_of_the_walk(trial: Trial, tmp_path: Path) -> None:
    """A robot without a foot on the floor never stands, one with all of them always."""
    felt = np.zeros((len(trial.log), 6), dtype=bool)
    read = recorded(trial, rewritten(trial, foot_contacts=felt), tmp_path / "flying.rrd")
    assert read.values("/__properties/trial", "stability") == [[0.0]]
    felt[:] = True
    read = recorded(trial, rewritten(trial, foot_contacts=felt), tmp_path / "standing.rrd")
    assert read.values("/__properties/trial", "stability") == [[1.0]]
    walk = np.flatnonzero(trial.log["phase"] == WALK)
    felt[walk[: walk.size // 4]] = False
    read = recorded(trial, rewritten(trial, foot_contacts=felt), tmp_path / "both.rrd")
    assert read.values("/__properties/trial", "stability") == [[pytest.approx(0.75, abs=0.01)]]


def test_the_ribbon_lies_between_line_and_trail_and_shows_the_side(read: ReadBack, trial: Trial) -> None:
    frame = trial.log.frame
    assert frame is not None
    quads = np.array(read.values(f"/{paths.RIBBON}", "Mesh3D:vertex_positions"))
    assert abs(len(quads) - len(trial.result.path_m) // 10) <= 1
    deviation = frame.path(quads.reshape(-1, 3))[:, 1].reshape(-1, 4)
    np.testing.assert_allclose(deviation[:, [1, 3]], 0, atol=2e-3)
    ends = np.round(read.times_s(f"/{paths.RIBBON}", "Mesh3D:vertex_positions") * 50).astype(int)
    expected = frame.path(trial.log["base_position_world"][ends])[:, 1]
    np.testing.assert_allclose(deviation[:, 2], expected, atol=2e-3)
    colors = np.array([value[0] for value in read.values(f"/{paths.RIBBON}", "Mesh3D:albedo_factor")])
    left, right = style.packed(style.LEFT_COLOR), style.packed(style.RIGHT_COLOR)
    np.testing.assert_array_equal(colors, np.where(expected >= 0, left, right))


def test_clipped_targets_and_missed_ticks_are_marked_and_told(trial: Trial, tmp_path: Path) -> None:
    sent = trial.log["wanted_rad"].copy()
    sent[60:63, 4] += 0.01
    times = trial.log["time_s"].copy()
    times[100:] += 0.06
    log = rewritten(trial, commanded_rad=sent, time_s=times)
    log.notes = [(90, "noticed: leg 5 locked")]
    read = recorded(trial, log, tmp_path / "troubled.rrd")
    at = np.round(read.times_s(f"/{paths.GUARD}", "StateChange:state") * 50).astype(int).tolist()
    states = [value[0] for value in read.values(f"/{paths.GUARD}", "StateChange:state")]
    usual, clipped, missed = style.GUARD_STATES
    assert list(zip(at, states, strict=True)) == [
        (0, usual), (60, clipped), (63, usual), (103, missed), (104, usual)
    ]  # fmt: skip
    told = [value[0] for value in read.values(f"/{paths.EVENTS}", "TextLog:text")]
    assert "clipped: leg2_femur" in told
    happened = np.round(read.times_s(f"/{paths.EVENTS}", "TextLog:text") * 50).astype(int).tolist()
    assert (90, "noticed: leg 5 locked") in zip(happened, told, strict=True)
    assert "missed 3 ticks: the one before took too long" in told
    assert [text for text in told if text.endswith("begins")] == [f"{phase} begins" for phase in PHASES]
    assert told[-1] == "trial over, ok"


def test_a_stop_is_marked_with_its_reason(tmp_path: Path) -> None:
    robot = shipped()
    plan = make_plan(robot, duration_s=3.0)
    path = tmp_path / "stopped.rrd"
    with (
        Recording(path, robot, plan, title="stopped") as recording,
        Guard(SimServos(robot)) as guard,
    ):
        log = TickLog()

        def stop_soon() -> bool:
            if len(log) == 80:
                guard.stop("estop")
            return False

        result = run_trial(guard, plan, recorders=(log, recording), stop_requested=stop_soon)
        recording.finish(result, {})
    read = ReadBack(path)
    assert result.status == "aborted"
    assert lane(read, paths.GUARD, len(log))[-1] == style.STOPPED
    assert read.values(f"/{paths.EVENTS}", "TextLog:text")[-1] == ["trial over, aborted: estop"]
    assert read.values(f"/{paths.EVENTS}", "TextLog:level")[-1] == ["ERROR"]


def ended(path: Path, trial: Trial, changes: dict[str, Any]) -> tuple[list[str], str]:
    """Level and text of how a trial is said to have ended, and the guard's last state."""
    result = replace(trial.result, **changes)
    with Recording(path, trial.robot, trial.plan, title="ended", floor=trial.floor) as recording:
        recording.write_block(trial.log, 0, len(trial.log))
        recording.finish(result, {})
    read = ReadBack(path)
    (level,), (text,) = (read.values(f"/{paths.EVENTS}", f"TextLog:{what}")[-1] for what in ("level", "text"))
    return [level, text], lane(read, paths.GUARD, len(trial.log))[-1]


@pytest.mark.slow
def test_only_what_went_wrong_is_an_error(trial: Trial, tmp_path: Path) -> None:
    no_pose = {"deviation": None, "distance_m": None}
    cases: list[tuple[dict[str, Any], str, bool]] = [
        ({"status": "ok", **no_pose}, "INFO", False),
        ({"status": "cut_short"}, "INFO", False),
        ({"status": "no_progress"}, "WARN", False),
        ({"status": "aborted", "stopped": "requested"}, "INFO", False),
        ({"status": "aborted", "stopped": "estop"}, "ERROR", True),
        ({"status": "fell"}, "ERROR", True),
    ]
    for number, (changes, level, stopped) in enumerate(cases):
        said, guard = ended(tmp_path / f"{number}.rrd", trial, changes)
        assert said[0] == level, said
        assert (guard == style.STOPPED) == stopped, said


def test_a_robot_that_knows_its_position_alone_is_drawn_on_its_way(
    read: ReadBack, trial: Trial, tmp_path: Path
) -> None:
    without = np.full((len(trial.log), 4), np.nan)
    alone = recorded(trial, rewritten(trial, base_quaternion_world=without), tmp_path / "alone.rrd")
    for path, component in (
        (paths.TRAIL, "LineStrips3D:strips"),
        (paths.RIBBON, "Mesh3D:vertex_positions"),
        (paths.DEVIATION, "Scalars:scalars"),
        (paths.ROBOT, "Transform3D:translation"),
    ):
        drawn = alone.values(f"/{path}", component)
        assert drawn == read.values(f"/{path}", component)
        assert drawn
    assert alone.values(f"/{paths.ROBOT}", "Transform3D:quaternion") == [[[0, 0, 0, 1]]] * len(trial.log)
    assert alone.values(f"/{paths.CENTRE}", "Points3D:positions") == []


def test_a_body_whose_orientation_is_lost_is_drawn_in_the_last_one(
    read: ReadBack, trial: Trial, tmp_path: Path
) -> None:
    path, component = f"/{paths.ROBOT}", "Transform3D:quaternion"
    lost = trial.log["base_quaternion_world"].copy()
    lost[70:150] = np.nan
    log = rewritten(trial, base_quaternion_world=lost)
    halves = ReadBack(write(tmp_path / "lost.rrd", replace(trial, log=log), block_ticks=100))
    drawn, whole = halves.values(path, component), read.values(path, component)
    assert drawn == whole[:70] + [whole[69]] * 80 + whole[150:]


def test_torques_are_drawn_where_they_are_known(read: ReadBack, trial: Trial, tmp_path: Path) -> None:
    path, torques_nm = f"/{paths.TORQUES}", trial.log["joint_torques_nm"]
    drawn = np.array(read.values(path, "Scalars:scalars"))
    np.testing.assert_allclose(drawn, torques_nm[::5], atol=2e-3)
    assert np.abs(drawn).max() > 0.1
    unknown = torques_nm.copy()
    unknown[10:] = np.nan
    partly = recorded(trial, rewritten(trial, joint_torques_nm=unknown), tmp_path / "partly.rrd")
    assert len(partly.values(path, "Scalars:scalars")) == 2


def test_the_velocity_of_a_steered_walk_is_drawn_and_an_open_loop_walk_has_none(
    read: ReadBack, trial: Trial, tmp_path: Path
) -> None:
    path, arrows = f"/{paths.VELOCITY}", f"/{paths.VELOCITY_ARROW}"
    assert read.values(path, "Scalars:scalars") == []
    velocity = np.full((len(trial.log), 3), np.nan)
    velocity[40:] = [0.15, -0.02, 0.1]
    steered = recorded(trial, rewritten(trial, velocity_body=velocity), tmp_path / "steered.rrd")
    drawn = np.array(steered.values(path, "Scalars:scalars"))
    np.testing.assert_allclose(drawn, velocity[40::5], atol=1e-4)
    vectors = np.array(steered.values(arrows, "Arrows3D:vectors")).reshape(-1, 3)
    np.testing.assert_allclose(vectors, [[0.3, -0.04, 0.0]] * len(drawn), atol=1e-3)
