"""The servo map: pulses and angles of channels."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot, load_robot_file
from hexctl.robot.servos.servo_map import DEFAULT_MAX_US, DEFAULT_MIN_US, ServoMap, default_servo_map
from hexctl.types import N_JOINTS
from tests.robots import edited_file, put, shipped


def per_joint(element: st.SearchStrategy[float]) -> st.SearchStrategy[list[float]]:
    return st.lists(element, min_size=N_JOINTS, max_size=N_JOINTS)


@st.composite
def servo_maps(draw: st.DrawFn) -> ServoMap:
    least = np.array(draw(per_joint(st.integers(100, 1400))), dtype=float)
    return ServoMap(
        channels=np.array(draw(st.permutations(range(1, N_JOINTS + 1)))),
        signs=np.array(draw(per_joint(st.sampled_from([-1.0, 1.0])))),
        offsets_deg=np.array(draw(per_joint(st.floats(-90, 90)))),
        least=least,
        most=least + draw(st.integers(100, 3000)),
        per_deg=np.full(N_JOINTS, draw(st.floats(1, 30))),
        centre=np.full(N_JOINTS, draw(st.floats(1000, 2000))),
    )


angles = per_joint(st.floats(-3.2, 3.2)).map(np.array)


@given(servo_maps(), angles)
def test_pulses_within_the_limits_mean_the_angles_they_came_from(
    servo_map: ServoMap, positions: np.ndarray[Any, Any]
) -> None:
    back = servo_map.to_rad(servo_map.to_us(positions))
    within = ~servo_map.outside(positions)
    np.testing.assert_allclose(back[within], positions[within], atol=1e-4)
    np.testing.assert_allclose(back, servo_map.limited_rad(positions), atol=1e-9)


@given(servo_maps(), angles)
def test_no_pulse_is_beyond_its_limits(servo_map: ServoMap, positions: np.ndarray[Any, Any]) -> None:
    pulses = servo_map.to_us(positions)[servo_map.channels - 1]
    assert (pulses >= servo_map.least).all()
    assert (pulses <= servo_map.most).all()
    assert servo_map.outside(positions).any() == (~np.isclose(pulses, servo_map.raw(positions))).any()


@given(servo_maps(), angles)
def test_every_channel_is_one_joint(servo_map: ServoMap, positions: np.ndarray[Any, Any]) -> None:
    for joint, channel in enumerate(servo_map.channels.tolist()):
        degrees = servo_map.signs[joint] * math.degrees(positions[joint]) + servo_map.offsets_deg[joint]
        wanted = servo_map.centre[joint] + servo_map.per_deg[joint] * degrees
        expected = min(max(wanted, servo_map.least[joint]), servo_map.most[joint])
        assert servo_map.to_us(positions)[channel - 1] == pytest.approx(expected)


def test_without_a_section_ninety_degrees_are_a_thousand_microseconds() -> None:
    servo_map = default_servo_map()
    positions = np.zeros(N_JOINTS)
    positions[0], positions[17] = math.radians(90), math.radians(-45)
    np.testing.assert_allclose(servo_map.to_us(positions), [2500, *[1500] * 16, 1000])
    assert (servo_map.least[0], servo_map.most[0]) == (DEFAULT_MIN_US, DEFAULT_MAX_US)


def test_a_joint_goes_before_its_kind_and_that_before_the_defaults(tmp_path: Path) -> None:
    section = {
        "us_per_deg": 10,
        "centre_us": 1520,
        "low_battery_v": 9.9,
        "tibia": {"offset_deg": 75, "sign": -1},
        "leg1_tibia": {"offset_deg": 70, "channel": 1, "max_us": 2300},
        "leg1_coxa": {"channel": 3},
    }
    servo_map = load_robot_file(edited_file(tmp_path, put("servos", section))).servo_map
    assert servo_map.channels[:3].tolist() == [3, 2, 1]
    assert servo_map.offsets_deg[:6].tolist() == [0, 0, 70, 0, 0, 75]
    assert servo_map.signs[:3].tolist() == [1, 1, -1]
    assert servo_map.most[:3].tolist() == [2500, 2500, 2300]
    assert (servo_map.per_deg[0], servo_map.centre[17], servo_map.low_battery_v) == (10, 1520, 9.9)


def test_it_changes_neither_the_robot_nor_its_fingerprint(tmp_path: Path) -> None:
    path = edited_file(tmp_path, put("servos", {"leg1_coxa": {"sign": -1, "offset_deg": 12}}))
    assert load_robot(path).fingerprint == shipped().fingerprint


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"leg7_coxa": {}}, "unknown key servos.leg7_coxa; did you mean .*; allowed here: .*leg6_tibia"),
        (
            {"leg1_coxa": {"chanel": 1}},
            r"unknown key servos.leg1_coxa.chanel; did you mean 'channel'\?; allowed here: channel",
        ),
        ({"coxa": {"channel": 1}}, "unknown key servos.coxa.channel"),
        ({"leg1_coxa": {"channel": 19}}, r"servos.leg1_coxa.channel: got 19; allowed: 18 or less"),
        ({"leg1_coxa": {"channel": 1.5}}, r"servos.leg1_coxa.channel: got 1.5; allowed: a whole number"),
        ({"leg1_coxa": {"channel": 2}}, "got channel 2 for leg1_coxa and leg1_femur; allowed: each"),
        ({"leg1_coxa": {"sign": 2}}, "servos.leg1_coxa.sign: got 2; allowed: 1 or -1"),
        ({"leg1_coxa": {"sign": True}}, "servos.leg1_coxa.sign: got True; allowed: a number"),
        ({"leg1_coxa": {"offset_deg": math.nan}}, "offset_deg: got nan; allowed: a finite number"),
        ({"leg1_coxa": {"min_us": 50}}, "min_us: got 50; allowed: 100 or more"),
        ({"leg1_coxa": {"min_us": 2600}}, "got min_us 2600 and max_us 2500; allowed: min_us below"),
        ({"us_per_deg": 0}, "servos.us_per_deg: got 0; allowed: above 0"),
        ({"low_battery_v": -1}, "servos.low_battery_v: got -1; allowed: above 0"),
        ([1], "servos: got .* allowed: a mapping"),
    ],
)
def test_what_no_map_can_be_is_refused_in_one_line(section: Any, message: str, tmp_path: Path) -> None:
    path = edited_file(tmp_path, put("servos", section))
    with pytest.raises(InputError, match=message) as refused:
        _ = load_robot_file(path).servo_map
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"channels": list(range(1, 19))},
            r"servos.channels: got .* \(list\); allowed: an array of shape",
        ),
        ({"signs": np.ones(6)}, r"servos.signs: got an array of shape \(6,\); allowed: shape \(18,\)"),
        ({"offsets_deg": np.full(18, np.nan)}, r"servos.offsets_deg: got nan; allowed: finite numbers"),
    ],
)
def test_a_map_of_wrong_arrays_is_refused_at_once(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(default_servo_map(), **change)
