"""Identification of a robot: motions on the stand, the replay of logs, and the file that is written."""

import itertools
import os
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from hexctl.backends.sim.world import World
from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from hexctl.identify.fit import SMALL_RAD, Fit, OnStage, fit_values, near_values
from hexctl.identify.identification import Identification
from hexctl.identify.identification_picture import SHOWN_S, draw_identification
from hexctl.identify.identified_file import write_identified
from hexctl.identify.options import IdentifyOptions
from hexctl.identify.parameters import OF_TRUNK, PARAMETERS, RobotValues
from hexctl.identify.robot_log import RobotLog, in_counts, read_robot_log
from hexctl.identify.stand_motions import StandMotions
from hexctl.identify.stand_run import IdentificationRun, move_on_stand
from hexctl.robot.configs import config_names, find_config
from hexctl.robot.loader import RobotFile, load_robot, load_robot_file
from hexctl.robot.yaml_text import yaml_content
from hexctl.runs.run import run
from hexctl.runs.run_spec import RunSpec
from hexctl.types import FloatArray, RobotState
from tests.robot.meshmaking import stl_box
from tests.robots import edited_file, put, shipped

#: A change of the text of lukas: its femurs are less stiff than the other joints.
OTHER_FEMUR = ("femur: {min", "femur: {stiffness_nm_per_rad: 20, min")


@pytest.mark.parametrize("name", config_names("robots"))
def test_motions_keep_angles_and_speeds_of_every_robot(name: str) -> None:
    robot, period_s = shipped(name), 0.02
    motions = StandMotions(robot, period_s)
    state = RobotState(robot.stance_angles_rad, 0.0, True)
    steps = round(motions.duration_s / period_s)
    targets = np.array([motions.targets_rad(step, state) for step in range(steps + 1)])
    assert (targets > robot.joint_lower_rad).all()
    assert (targets < robot.joint_upper_rad).all()
    assert (np.abs(np.diff(targets, axis=0)) <= robot.joint_max_speed_rad_s * period_s).all()
    assert (np.ptp(targets, axis=0) > 0.1).all()
    np.testing.assert_allclose(targets[-1], robot.stance_angles_rad, atol=0.05)
    assert motions.done(steps, state)


def test_an_interrupted_search_names_its_stages_and_the_command_that_continues(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, on_step: OnStage, **__: object) -> None:
        for stage, step in (("fast", 0), ("fast", 1), ("complete", 0)):
            on_step(stage, step, 0.01)
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("hexctl.identify.identification.identify", interrupted)
    assert exit_code(["identify", "a b.rrd", "--robot", "ant", "-o", "new.yaml"]) == 130
    said = capsys.readouterr().err.splitlines()
    assert said[1:4] == [
        f"search, {stage}, error 0.573 deg" for stage in ("fast: step 1", "fast: step 2", "complete: step 1")
    ]
    assert said[4].endswith("continue with: hexctl identify 'a b.rrd' --robot ant -o new.yaml")


def test_a_search_ends_below_what_sensors_show() -> None:
    log = Mock(spec=RobotLog, units=1, parameters=("play_deg",))
    log.errors_rad = lambda values: np.full((8, 18), np.radians(values.play_deg))
    steps: list[int] = []
    for play_deg, most in ((1e-3, 1), (5.0, 10)):
        start = replace(RobotValues.of(shipped()), play_deg=play_deg)
        error_rad, _ = near_values([log], start, ["play_deg"], lambda step, _: steps.append(step))
        assert error_rad < SMALL_RAD
        assert steps.pop() < most
        steps.clear()


@pytest.mark.slow
def test_drawn_servos_are_found_on_the_stand(tmp_path: Path) -> None:
    """By the fast waves; of a robot whose legs weigh enough that the stand alone sets the scale."""
    robot = shipped("lukas")
    world = World(on_stand=True, servo_stiffness=0.8, rotor_inertia_kg_m2=0.012, servo_delay_s=0.006)
    move_on_stand(robot=robot, world=world, record=tmp_path / "stand.rrd")
    whole = read_robot_log(tmp_path / "stand.rrd")
    assert whole.on_stand
    part = slice(600, 1100)
    log = replace(
        whole,
        time_s=whole.time_s[part],
        commanded_rad=whole.commanded_rad[part],
        measured_rad=whole.measured_rad[part],
    )
    fit = fit_values(
        [log], RobotValues.of(robot), ("stiffness_nm_per_rad", "rotor_inertia_kg_m2", "dead_time_s")
    )
    stiffness = 0.8 * robot.servo.stiffness_nm_per_rad
    assert fit.values.stiffness_nm_per_rad == pytest.approx(stiffness, rel=0.1)
    assert fit.values.rotor_inertia_kg_m2 == pytest.approx(0.012, rel=0.15)
    assert fit.values.dead_time_s == pytest.approx(0.026, abs=0.003)
    assert fit.after_rad["stand.rrd"] < 0.5 * fit.before_rad["stand.rrd"]


def test_a_world_without_a_stand_is_refused() -> None:
    with pytest.raises(InputError, match="world"):
        IdentificationRun(RunSpec(world="slope"))


def test_a_walk_in_the_world_stand_is_one_on_a_stand(tmp_path: Path) -> None:
    run(robot="pexod", world="stand", record=tmp_path / "walk.rrd", duration_s=5.1, hold="none")
    assert read_robot_log(tmp_path / "walk.rrd").on_stand


@pytest.mark.slow
def test_a_load_on_the_trunk_is_found_in_a_walk(tmp_path: Path) -> None:
    robot, shift_m = shipped("lukas"), (0.02, -0.015, 0.0)
    world = World(added_mass_share=0.2, body_mass_shift_m=shift_m)
    run(robot=robot, world=world, record=tmp_path / "walk.rrd", duration_s=3.0, hold="none")
    log = read_robot_log(tmp_path / "walk.rrd")
    assert not log.on_stand
    fit = fit_values([log], RobotValues.of(robot), OF_TRUNK)
    assert fit.values.trunk_mass_kg == pytest.approx(robot.body.mass_kg + 0.2 * robot.mass_kg, rel=0.03)
    com_m = np.array(robot.body.com_m) + shift_m
    assert fit.values.trunk_com_x_m == pytest.approx(com_m[0], abs=0.002)
    assert fit.values.trunk_com_y_m == pytest.approx(com_m[1], abs=0.002)
    assert all(one.known for one in fit.estimates.values())


def found(name: str = "lukas", **given: tuple[float, float]) -> Identification:
    """A result with values and standard errors."""
    estimates = {key: PARAMETERS[key].estimate(*one) for key, one in given.items()}
    return Identification(Fit(RobotValues.of(shipped(name)), estimates, {"log": 0.02}, {"log": 0.01}), {}, ())


def lukas(
    folder: Path, *changes: tuple[str, str], **given: tuple[float, float]
) -> tuple[RobotFile, RobotFile]:
    """The file of lukas with changes of its text, and what is written when values of it were found."""
    text = find_config("robots", "lukas").read_text()
    for change in changes:
        text = text.replace(*change)
    before, after = folder / "mine.yaml", folder / "identified.yaml"
    before.write_text(text)
    write_identified(before, found("lukas", **given), after)
    return load_robot_file(before), load_robot_file(after)


def test_a_file_gets_what_is_known_and_keeps_the_rest(tmp_path: Path) -> None:
    file, written = lukas(
        tmp_path,
        stiffness_nm_per_rad=(20.0, 0.5),
        rotor_inertia_kg_m2=(0.01, 0.001),
        dry_friction_nm=(0.2, 0.15),
        max_torque_nm=(3.434, 0.68),
        dead_time_s=(0.012, 0.001),
        trunk_mass_kg=(2.9454, 0.05),
        trunk_com_x_m=(0.01, 0.001),
        trunk_com_y_m=(0.02, 0.009),
    )
    before, robot = file.robot, written.robot
    assert robot.servo.stiffness_nm_per_rad == 20.0
    assert robot.servo.rotor_inertia_kg_m2 == 0.01
    assert robot.servo.dead_time_s == 0.012
    assert robot.servo.damping_nm_s_per_rad == before.servo.damping_nm_s_per_rad
    np.testing.assert_array_equal(robot.dry_friction_nm, before.dry_friction_nm)
    np.testing.assert_array_equal(robot.joint_max_torque_nm, before.joint_max_torque_nm)
    np.testing.assert_array_equal(robot.joint_no_load_speed_rad_s, before.joint_no_load_speed_rad_s)
    np.testing.assert_array_equal(robot.mount_positions_body, before.mount_positions_body)
    assert written.content.servos == file.content.servos
    assert "# front left, middle left" in (tmp_path / "identified.yaml").read_text()
    assert robot.body.mass_kg == 2.945
    assert robot.body.com_m == before.body.com_m
    assert robot.body.inertia_kg_m2 is not None
    assert before.body.inertia_kg_m2 is not None
    np.testing.assert_allclose(robot.body.inertia_kg_m2, 2 * np.array(before.body.inertia_kg_m2), rtol=1e-3)


def test_what_was_measured_is_no_longer_unknown(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    known = {"stiffness_nm_per_rad": (20.0, 0.02), "dry_friction_nm": (0.2, 0.02)}
    write_identified("jethexa", found("jethexa", **known, trunk_mass_kg=(1.0, 0.3)), path)
    unknown = load_robot_file(path).content.unknown
    assert {"body.mass_kg", "servo.rotor_inertia_kg_m2", "joints.femur.max_torque_nm"} <= set(unknown)
    assert not {"servo", "servo.stiffness_nm_per_rad", "joints.femur.dry_friction_nm"} & set(unknown)
    assert load_robot(path).body.mass_kg == load_robot("jethexa").body.mass_kg


def test_a_centre_of_which_one_part_is_known_stays_unknown(tmp_path: Path) -> None:
    centre = {"trunk_com_x_m": (0.01, 0.001), "trunk_com_y_m": (0.02, 0.009)}
    change = ("unknown: [", "unknown: [body.com_m, ")
    before, after = lukas(tmp_path, change, stiffness_nm_per_rad=(20.0, 0.5), **centre)
    assert after.robot.body.com_m == before.robot.body.com_m
    assert "body.com_m" in after.content.unknown


@pytest.mark.parametrize("known", [True, False])
def test_of_a_p_gain_the_stiffness_is_unknown_until_it_is_measured(known: bool, tmp_path: Path) -> None:
    given = {"stiffness_nm_per_rad": (20.0, 0.5 if known else 20.0), "damping_nm_s_per_rad": (0.5, 0.01)}
    before, after = lukas(tmp_path, ("unknown: [", "unknown: [servo, "), **given)
    old, new = (yaml_content(file.path.read_text())["servo"] for file in (before, after))
    assert new["p_gain"] == old["p_gain"]
    stiffness = new["stiffness_nm_per_rad_per_p_gain"] * new["p_gain"]
    assert (stiffness == pytest.approx(20.0, rel=1e-3)) == known
    assert {key for key in after.content.unknown if key.startswith("servo.")} == {
        *(() if known else ("servo.stiffness_nm_per_rad",)),
        "servo.rotor_inertia_kg_m2",
        "servo.gear_damping_nm_s_per_rad",
        "servo.dead_time_s",
    }


def test_an_identified_file_has_the_meshes_of_its_robot(tmp_path: Path) -> None:
    (tmp_path / "box.stl").write_bytes(stl_box())
    (tmp_path / "there").mkdir()
    body, coxa = {"file": "box.stl"}, {"file": str(tmp_path / "box.stl")}
    mine = edited_file(tmp_path, put("meshes", {"body": body, "coxa": coxa}))
    written, copied = (tmp_path / "there" / name for name in ("identified.yaml", "copied.yaml"))
    write_identified(mine, found("ant", stiffness_nm_per_rad=(20.0, 0.5)), written)
    assert exit_code(["robot", "copy", str(mine), str(copied)]) == 0
    for file in (written, copied):
        assert load_robot_file(file).meshes["body"].content == stl_box()
        assert load_robot_file(file).content.meshes.coxa == load_robot_file(mine).content.meshes.coxa


def test_a_stand_shows_no_trunk() -> None:
    assert found(stiffness_nm_per_rad=(20.0, 0.02)).not_seen == list(OF_TRUNK)


@pytest.mark.parametrize("name", ["mine.txt", "there.yaml", "none/mine.yaml", "mine.yaml"])
def test_an_output_that_cannot_be_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "there.yaml").touch()
    robot = edited_file(tmp_path, put("meshes", {"body": {"file": "missing.stl"}}))
    with pytest.raises(InputError, match="meshes.body" if name == "mine.yaml" else "output"):
        IdentifyOptions(robot=robot, output=tmp_path / name).check_output()


@pytest.mark.parametrize("name", ["stiffness_nm_per_rad", "femur_stiffness_ratio"])
def test_a_measured_stiffness_of_a_joint_is_no_longer_unknown(name: str, tmp_path: Path) -> None:
    key = "joints.femur.stiffness_nm_per_rad"
    known = {"stiffness_nm_per_rad": (20.0, 20.0), name: (1.0, 0.1)}
    _, after = lukas(tmp_path, ("unknown: [", f"unknown: [{key}, "), OTHER_FEMUR, **known)
    assert key not in after.content.unknown


def test_joints_keep_the_proportions_of_their_stiffnesses(tmp_path: Path) -> None:
    """Also those that have the stiffness of the P gain, which is no mean."""
    before, after = lukas(tmp_path, OTHER_FEMUR, stiffness_nm_per_rad=(30.0, 0.5))
    share = 30.0 / before.robot.stiffness_nm_per_rad.mean()
    expected = share * before.robot.stiffness_nm_per_rad
    np.testing.assert_allclose(after.robot.stiffness_nm_per_rad, expected, rtol=1e-3)


def test_joint_kinds_get_their_stiffness_and_play(tmp_path: Path) -> None:
    ratios = {"coxa_stiffness_ratio": (2.5, 0.1), "femur_stiffness_ratio": (1.5, 0.1)}
    result = found("ant", stiffness_nm_per_rad=(30.0, 1.0), play_deg=(0.6, 0.1), **ratios)
    write_identified("ant", result, tmp_path / "identified.yaml")
    robot = load_robot(tmp_path / "identified.yaml")
    np.testing.assert_allclose(robot.stiffness_nm_per_rad[:3], (45.0, 27.0, 18.0))
    np.testing.assert_allclose(np.degrees(robot.play_rad), 0.6)
    assert RobotValues.of(robot).kind_stiffnesses_nm_per_rad == pytest.approx((45.0, 27.0, 18.0))


def test_weak_servos_lose_speed_and_keep_their_back_emf(tmp_path: Path) -> None:
    before = RobotValues.of(shipped("lukas"))
    torque = (0.4 * before.max_torque_nm, 0.05)
    _, written = lukas(tmp_path, stiffness_nm_per_rad=(30.0, 1.0), max_torque_nm=torque)
    after = RobotValues.of(written.robot)
    assert after.max_torque_nm == pytest.approx(0.4 * before.max_torque_nm, rel=1e-3)
    assert after.back_emf_nm_s_per_rad == pytest.approx(before.back_emf_nm_s_per_rad, rel=1e-3)


def test_motions_that_did_not_end_and_recordings_of_others_are_refused(tmp_path: Path) -> None:
    ticks = itertools.count()
    move_on_stand(robot="pexod", record=tmp_path / "part.rrd", stop_requested=lambda: next(ticks) > 150)
    with pytest.raises(InputError, match="did not end"):
        read_robot_log(tmp_path / "part.rrd")
    with pytest.raises(InputError, match=r"differ by .* from those of lukas"):
        read_robot_log(tmp_path / "part.rrd", shipped("lukas"))


@pytest.mark.parametrize("left_rad", [0.003, 0.02])
def test_a_poor_fit_is_noted_and_the_file_is_the_next_step(
    left_rad: float, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    result = found(stiffness_nm_per_rad=(20.0, 0.5), max_torque_nm=(3.0, 0.1), dead_time_s=(0.0595, 0.001))
    log = Mock(spec=RobotLog, on_stand=True, stale_s=max(0.0, left_rad - 0.003))
    log.repeated_share, log.skipped_share = left_rad, 0.0
    log.name = "log"
    result = replace(result, fit=replace(result.fit, after_rad={"log": left_rad}), replays=(log,))
    monkeypatch.setattr("hexctl.identify.identification.identify", lambda *_, **__: result)
    assert exit_code(["identify", "some.rrd"]) == 0
    said = capsys.readouterr()
    assert ("a poor fit" in said.err) == (left_rad > 0.01)
    assert ("readings stood still for 0.017 s" in said.err) == (left_rad > 0.01)
    assert "at the limit of the search" in said.out
    assert "hexctl identify some.rrd --robot ROBOT -o FILE.yaml" in said.out.replace("\n", " ")


def test_readings_that_a_slow_link_repeats_are_found() -> None:
    time_s = np.arange(0.0, 6.0, 0.02)
    commanded = np.tile(np.sin(2.0 * time_s)[:, np.newaxis], 18)
    measured = commanded.copy()
    assert RobotLog("walk", shipped(), False, time_s, commanded, measured).stale_s == 0.0
    measured[100:112] = measured[100]
    stale = RobotLog("walk", shipped(), False, time_s, commanded, measured)
    assert stale.stale_s == pytest.approx(0.16, abs=0.021)
    at_rest = np.where(time_s < 3.0, 0.0, 1.0)[:, np.newaxis] * np.ones(18)
    late = np.where(time_s < 3.08, 0.0, 1.0)[:, np.newaxis] * np.ones(18)
    assert replace(stale, commanded_rad=at_rest, measured_rad=late).stale_s == 0.0


def test_commands_are_rounded_to_the_counts_of_the_readings() -> None:
    """Not those of joints whose readings are no counts, as of a simulation."""
    count_rad, zero_rad, time_s = 2 * np.pi / 4096, 0.0007, np.arange(0.0, 20.0, 0.02)
    commanded = 0.4 * np.sin(np.arange(1.0, 3.6, 0.15) * time_s[:, np.newaxis])
    counts = zero_rad + count_rad * np.rint((commanded - zero_rad) / count_rad)
    stored = 16e-6 * np.rint(counts / 16e-6)
    stored[:, :9] = 16e-6 * np.rint(commanded[:, :9] / 16e-6)
    rounded = in_counts(commanded, stored)
    np.testing.assert_array_equal(rounded[:, :9], commanded[:, :9])
    other = np.abs(rounded - counts)[:, 9:] > 1e-5
    assert other.mean() < 1e-3, "those half-way between two counts"


@pytest.mark.parametrize("every", [1, 2, 3])
def test_readings_that_a_busy_computer_repeats_or_skips_are_counted(every: int) -> None:
    """A joint that turns back, or pauses for long, repeats nothing."""
    time_s = np.arange(0.0, 40.0, 0.02)
    swung = np.where(time_s % 10.0 < 8.0, 0.5 * np.sin(5.0 * np.pi * time_s), 0.0)
    measured = np.tile(swung[:, np.newaxis], 18)
    log = RobotLog("walk", shipped(), False, time_s, measured, measured)
    assert (log.repeated_share, log.skipped_share) == pytest.approx((0.0, 0.0))
    again = measured[np.arange(len(measured)) // every * every]
    assert replace(log, measured_rad=again).repeated_share == pytest.approx(1 - 1 / every, abs=0.02)
    kept = np.arange(len(time_s)) % 20 > 0
    parts = {name: getattr(log, name)[kept] for name in ("time_s", "commanded_rad", "measured_rad")}
    assert replace(log, **parts).skipped_share == pytest.approx(0.05, abs=0.001)


@pytest.mark.slow
def test_the_picture_shows_the_worst_joint_of_each_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matplotlib.figure import Figure

    time_s, measured = np.arange(0.0, 20.0, 0.02), np.zeros((1000, 18))
    bump_rad: FloatArray = np.where(abs(time_s - 12.0) < 1.0, 0.1, 0.0)[:, np.newaxis] * (np.arange(18) == 4)
    log = SimpleNamespace(
        name="walk.rrd", time_s=time_s, measured_rad=measured, errors_rad=lambda _: bump_rad
    )
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    draw_identification(replace(found(), replays=(log,)), None, tmp_path / "some.png")
    angles, errors = drawn[0].axes
    assert angles.get_title("left").startswith("walk.rrd, leg2_femur; ")
    shown_s = np.asarray(errors.lines[0].get_xdata(), dtype=float)
    assert shown_s[0] <= 11.02
    assert shown_s[-1] >= 12.9
    assert np.ptp(shown_s) < SHOWN_S
