"""Recordings read back: the arrays are those of the walk."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from hexctl.backends.clock import Tick
from hexctl.columns import RECORDED
from hexctl.control.log import TickLog
from hexctl.errors import InputError
from hexctl.recording import paths, style
from hexctl.recording.recorded_trial import LEG_CONDITIONS, RecordedTrial, read_trial
from hexctl.recording.recording import Recording
from hexctl.robot.loader import load_robot
from hexctl.runs.run import run
from hexctl.types import N_JOINTS, JointTargets, RobotState
from tests.control.posed import readings
from tests.recording.conftest import ReadBack, Trial, write


@pytest.fixture(scope="module")
def read(tmp_path_factory: Any, trial: Trial) -> RecordedTrial:
    return read_trial(write(tmp_path_factory.mktemp("read") / "a.rrd", trial, block_ticks=40))


def test_position_and_orientation_are_known_tick_by_tick(trial: Trial, tmp_path: Path) -> None:
    place, turn = trial.log["base_position_world"].copy(), trial.log["base_quaternion_world"].copy()
    place[10:20], turn[30:40], place[50:60], turn[50:60] = (np.nan,) * 4
    for positions in (place, np.full_like(place, np.nan)):
        gaps = trial.with_columns(base_position_world=positions, base_quaternion_world=turn)
        read = read_trial(write(tmp_path / f"{np.isnan(positions).sum()}.rrd", gaps))
        assert read.base_position_world == pytest.approx(positions, abs=8e-6, nan_ok=True)
        assert read.base_quaternion_world == pytest.approx(turn, abs=8e-6, nan_ok=True)


@pytest.mark.slow
def test_it_is_what_was_walked(read: RecordedTrial, trial: Trial) -> None:
    log = trial.log
    assert len(read) == len(log)
    assert read.time_s == pytest.approx(log["time_s"] - log["time_s"][0], abs=1e-9)
    assert read.walk_s[-1] == pytest.approx(log["time_s"][-1] - log["time_s"][log.walk_from], abs=1e-9)
    assert np.array_equal(read.phases, log["phase"])
    assert read.commanded_rad == pytest.approx(log["commanded_rad"], abs=1.23e-4)
    assert read.measured_rad == pytest.approx(log["measured_rad"], abs=1.23e-4)
    assert read.base_position_world == pytest.approx(log["base_position_world"], abs=8e-6)
    assert read.base_quaternion_world == pytest.approx(log["base_quaternion_world"], abs=8e-6)
    assert read.sensors.keys() == {column.name for column in RECORDED} - {"velocity_body"}
    for column in RECORDED[:-1]:
        sensor = read.sensors[column.name]
        assert np.array_equal(sensor.rows, np.arange(len(log))[:: column.ticks]), column.name
        assert sensor.values == pytest.approx(1.0 * log[column.name][sensor.rows], abs=2e-3), column.name
        assert np.abs(sensor.values).max() > 0.1, column.name
    rate_rad_s = read.sensors["angular_velocity_body_rad_s"].values
    assert rate_rad_s == pytest.approx(log["angular_velocity_body_rad_s"], abs=8e-6)
    sparse = read.sensors["joint_torques_nm"]
    assert np.isnan(sparse.at_every_tick(len(log))[1]).all()
    assert not read.servos
    assert read.robot == trial.robot
    assert read.properties["status"] == trial.result.status
    assert read.properties["failed_leg"] == 5
    assert read.events[0].text == "settle begins"
    assert read.events[-1].text.startswith("trial over")
    assert read.events[-1].row == len(trial.log) - 1


def test_the_line_of_travel_begins_where_the_walk_does_and_leads_along_it(
    read: RecordedTrial, trial: Trial
) -> None:
    frame = trial.log.frame
    assert frame is not None
    assert read.course_world is not None
    start_m, end_m = read.course_world
    assert start_m[:2] == pytest.approx(frame.origin_world[:2], abs=1e-6)
    along = (end_m - start_m)[:2]
    assert np.arctan2(along[1], along[0]) == pytest.approx(frame.heading_rad, abs=1e-6)


def conditions(trial: RecordedTrial, leg: int) -> list[tuple[int, str]]:
    """Conditions of a leg, each with the tick from which on it is so."""
    indices = trial.leg_conditions[:, leg - 1]
    starts = [0, *(np.flatnonzero(np.diff(indices)) + 1).tolist()]
    return [(row, LEG_CONDITIONS[indices[row]]) for row in starts]


@pytest.mark.slow
def test_legs_that_failed_before_the_walk(read: RecordedTrial, tmp_path: Path) -> None:
    assert [conditions(read, leg) for leg in (4, 5)] == [[(0, "whole")], [(0, "failed")]]
    path = tmp_path / "two.rrd"
    run(failure="3:missing,6:limp", gait="auto", duration_s=0.2, record=path)
    two = read_trial(path)
    assert [conditions(two, leg) for leg in (2, 3, 6)] == [[(0, "whole")], [(0, "missing")], [(0, "failed")]]


@pytest.mark.slow
def test_legs_that_fail_are_noticed_and_heal_in_a_walk(tmp_path: Path) -> None:
    path = tmp_path / "healed.rrd"
    failing: dict[str, Any] = {"failure": "5:locked@1", "heal": ["5@2.5"], "recovery": "walk-on"}
    result = run(gait="tripod", duration_s=3.5, record=path, **failing)
    (noticed,) = result.trial.noticed
    assert noticed.at_s < 2.5
    read = read_trial(path)
    begun = int(np.flatnonzero(read.walk_s > 0)[0]) - 1
    found = conditions(read, 5)
    assert [name for _, name in found] == ["whole", "failed", "noticed"]
    assert [row - begun for row, _ in found[1:]] == pytest.approx([50, 125], abs=1)
    assert conditions(read, 1) == [(0, "whole")]


def test_a_place_and_contacts_that_are_not_known_are_none(trial: Trial, tmp_path: Path) -> None:
    position_m = trial.log["base_position_world"].copy()
    position_m[:70] = np.nan
    read = read_trial(write(tmp_path / "later.rrd", trial.with_columns(base_position_world=position_m)))
    assert np.array_equal(read.posed, np.arange(len(read)) >= 70)
    contacts = np.full_like(trial.log["foot_contacts"], np.nan)
    never = trial.with_columns(base_position_world=np.full_like(position_m, np.nan), foot_contacts=contacts)
    never.robot = replace(trial.robot, name="mine", foot_radius_m=0.009)
    unfelt = read_trial(write(tmp_path / "never.rrd", never))
    assert not unfelt.posed.any()
    assert "foot_contacts" not in unfelt.sensors
    assert unfelt.robot == never.robot


@pytest.mark.parametrize("block_ticks", [None, 7])
def test_a_value_that_is_unknown_at_some_ticks_is_left_out_there(
    block_ticks: int | None, trial: Trial, tmp_path: Path
) -> None:
    log, stance = TickLog(), trial.robot.stance_angles_rad
    for index in range(101):
        state = RobotState(
            stance,
            0.02 * index,
            measured=True,
            foot_contacts=None if index < 50 else np.ones(6, dtype=bool),
            joint_torques_nm=None if index == 100 else np.ones(N_JOINTS),
        )
        log.record(Tick(index, 0.02 * index), state, stance, JointTargets(stance, 0.02 * index))
    path = write(tmp_path / "partly.rrd", replace(trial, log=log), block_ticks)
    read = read_trial(path)
    assert read.sensors["joint_torques_nm"].rows.tolist() == list(range(0, 100, 5))
    assert read.sensors["foot_contacts"].rows.tolist() == list(range(50, 101))
    assert (read.sensors["foot_contacts"].values == 1).all()
    drawn = ReadBack(path).rows(f"/{paths.foot_path(1)}", "Points3D:colors")
    colors = [style.packed(color) for color in (style.UNFELT_COLOR, style.TOUCHING_COLOR)]
    assert [value for at_ns, (value,) in drawn if at_ns is not None] == colors


def test_what_servos_reported(trial: Trial, tmp_path: Path) -> None:
    told = trial.with_columns()
    values = np.linspace(20, 40, N_JOINTS)
    for row in (0, 50):
        told.log.servo_rows.append(row, readings(temperatures_c=values))
    servos = read_trial(write(tmp_path / "servos.rrd", told)).servos
    assert set(servos) == {"ages_s", "temperatures_c"}
    assert servos["temperatures_c"].rows.tolist() == [0, 50]
    assert servos["temperatures_c"].values == pytest.approx(np.tile(values, (2, 1)), abs=0.01)


@pytest.mark.parametrize("parts", [1, 3])
def test_of_a_program_that_was_killed_while_it_wrote_all_is_read_but_the_last_block(
    parts: int, trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexctl.recording.recording.BLOCK_TICKS", 60)
    path = tmp_path / "killed.rrd"
    recording = Recording(path, trial.robot, trial.plan, title="killed")
    written = 0
    for stop in range(60, 10_000, 10):
        recording.write_block(trial.log, written, min(stop, len(trial.log)))
        written = min(stop, len(trial.log))
        if recording._written >= 180:
            break
    for _ in range(parts):
        recording._write_part()
    recording._parts, recording._due = None, recording._written  # nothing more gets to the disk
    recording.close()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = read_trial(path)
    assert 60 <= len(read) <= len(trial.log)
    assert read.properties == {"title": "killed"}
    times_s = trial.log["time_s"]
    assert read.time_s == pytest.approx(times_s[: len(read)] - times_s[0], abs=1e-9)
    assert len(read.walk_s) == len(read.phases) == len(read.base_position_world) == len(read)
    assert read.measured_rad == pytest.approx(trial.log["measured_rad"][: len(read)], abs=1.23e-4)
    positions = trial.log["base_position_world"][: len(read)]
    assert read.base_position_world == pytest.approx(positions, abs=8e-6, nan_ok=True)


@pytest.mark.slow
def test_damage_is_read_around(trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.recording.recording.BLOCK_TICKS", 40)
    path = write(tmp_path / "walk.rrd", trial, block_ticks=1)
    intact, content = read_trial(path), path.read_bytes()
    for at in range(len(content) // 3, len(content) * 2 // 3, len(content) // 40):
        path.write_bytes(content[:at] + bytes(3000) + content[at + 3000 :])
        read = read_trial(path)
        assert len(read) >= len(intact) - 90, "at most two blocks"
        rows = np.searchsorted(intact.time_s, read.time_s)
        for name in ("time_s", "walk_s", "stamps_ns", "commanded_rad", "measured_rad"):
            assert np.array_equal(getattr(read, name), getattr(intact, name)[rows]), name
        known = read.posed
        assert np.array_equal(read.base_position_world[known], intact.base_position_world[rows][known])
        samples, all_samples = (one.sensors["joint_torques_nm"] for one in (read, intact))
        found = np.searchsorted(all_samples.rows, rows[samples.rows])
        assert np.array_equal(samples.values, all_samples.values[found])


def test_what_is_no_recording_of_a_trial_is_refused_in_one_line(tmp_path: Path) -> None:
    import rerun as rr

    damaged, empty, other = (tmp_path / f"{name}.rrd" for name in ("damaged", "empty", "other"))
    damaged.write_bytes(b"nonsense")
    empty.write_bytes(b"")
    with rr.RecordingStream("other") as stream:
        stream.save(str(other))
        stream.log("x", rr.Scalars([1.0]))
    for path in (damaged, empty, other, tmp_path / "missing.rrd", tmp_path / "a.txt"):
        with pytest.raises(InputError, match="recording: ") as refused:
            read_trial(path)
        assert str(path) in str(refused.value)
        assert "\n" not in str(refused.value)


def test_a_recording_without_its_robot_is_read_with_one(
    trial: Trial, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr("hexctl.recording.recording.robot_to_json", lambda _: None)
    unknown = write(tmp_path / "unknown.rrd", trial)
    with pytest.raises(InputError):
        read_trial(unknown)
    assert read_trial(unknown, robot=load_robot("ant")).robot == trial.robot


def test_action_and_state_are_vectors_in_one_row_at_every_tick(trial: Trial, tmp_path: Path) -> None:
    read = ReadBack(write(tmp_path / "trial.rrd", trial))
    assert pa.types.is_timestamp(read.time_type("/action", "wall_time")), "rerun-lerobot reads no durations"
    times_s, same_s = (
        read.times_s(f"/{one}", "Scalars:scalars", "wall_time") for one in ("action", "observation/state")
    )
    assert np.array_equal(times_s, same_s)
    assert np.diff(times_s) == pytest.approx(np.diff(trial.log["time_s"]), abs=1e-6)
    for entity, name in (("action", "commanded_rad"), ("observation/state", "measured_rad")):
        values = np.array(read.values(f"/{entity}", "Scalars:scalars"))
        assert values.shape == (len(trial.log), N_JOINTS)
        assert values == pytest.approx(trial.log[name], abs=np.radians(0.09)), "finer than servos resolve"
