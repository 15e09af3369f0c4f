"""Levels of diagnostics."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.server.ros.diagnostics import silent, statuses
from hexctl.server.ros.snapshot import RobotSnapshot
from hexctl.types import N_JOINTS, RobotState, ServoReadings
from hexctl.wire.ros.telemetry import Level

SERVOS = ServoReadings(
    ages_s=np.zeros(N_JOINTS),
    efforts=np.zeros(N_JOINTS),
    currents_a=np.full(N_JOINTS, np.nan),
    voltages_v=np.full(N_JOINTS, 7.4),
    temperatures_c=np.full(N_JOINTS, 35.0),
)
STATE = RobotState(np.zeros(N_JOINTS), 0.0, True, servos=SERVOS, battery_v=11.1, battery_share=0.5)


def told(state: RobotState, stopped: str | None = None) -> RobotSnapshot:
    return RobotSnapshot(state, orientation=None, stopped=stopped, posture="commanded", controller="me")


def test_all_is_well() -> None:
    robot, *servos = statuses(told(STATE))
    assert robot.level is Level.OK
    assert robot.values["battery (V)"] == "11.1"
    assert robot.values["charge (%)"] == "50"
    assert len(servos) == N_JOINTS
    assert servos[3].name == "hexctl: leg2_coxa"
    assert servos[3].values == {"temperature (C)": "35", "voltage (V)": "7.4", "effort (%)": "0"}


@pytest.mark.parametrize(
    ("change", "stopped", "level", "word"),
    [
        ({"warnings": ("leg 2: low voltage",)}, None, Level.WARN, "low voltage"),
        ({"age_s": np.inf}, None, Level.STALE, "nothing new"),
        ({}, "fell", Level.ERROR, "stopped: fell (its body leant too far)"),
        ({"healthy": False, "fault": "no power"}, None, Level.ERROR, "no power"),
    ],
)
def test_levels_of_a_robot(change: dict[str, object], stopped: str | None, level: Level, word: str) -> None:
    robot = statuses(told(replace(STATE, **change), stopped))[0]  # type: ignore[arg-type]
    assert (robot.level, word in robot.message) == (level, True)


@pytest.mark.parametrize(
    ("temperature_c", "age_s", "error", "level"),
    [
        (62.0, 0.0, "", Level.WARN),
        (69.0, 0.0, "", Level.ERROR),
        (35.0, np.inf, "", Level.STALE),
        (35.0, 0.0, "overload", Level.ERROR),
        (np.nan, 0.0, "", Level.OK),
    ],
)
def test_levels_of_a_servo(temperature_c: float, age_s: float, error: str, level: Level) -> None:
    temperatures, ages = SERVOS.temperatures_c.copy(), SERVOS.ages_s.copy()
    temperatures[4], ages[4] = temperature_c, age_s
    errors = tuple(error if joint == 4 else "" for joint in range(N_JOINTS))
    servos = replace(SERVOS, temperatures_c=temperatures, ages_s=ages, errors=errors)
    levels = [status.level for status in statuses(told(replace(STATE, servos=servos)))[1:]]
    assert levels == [level if joint == 4 else Level.OK for joint in range(N_JOINTS)]


def test_stale_joints_are_stale() -> None:
    stale = np.arange(N_JOINTS) == 17
    levels = [status.level for status in statuses(told(replace(STATE, stale_joints=stale)))[1:]]
    assert levels[17] is Level.STALE
    assert levels[:17] == [Level.OK] * 17


def test_a_robot_without_readings_of_servos_has_one_status() -> None:
    assert len(statuses(told(replace(STATE, servos=None)))) == 1
    assert [one.level for one in silent()] == [Level.STALE]
