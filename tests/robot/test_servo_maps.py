"""Servo maps: which output or servo moves which joint, and the angles its raw values mean."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot, load_robot_file
from hexctl.robot.servos.bus_map import BusMap, bus_map_of
from hexctl.robot.servos.drivers import BUS_DRIVERS
from hexctl.robot.servos.pwm_map import PwmMap, pwm_map_of
from hexctl.robot.servos.raw_map import joints_beyond, reference_deg
from hexctl.robot.servos.servo_map import DEFAULT_MAX_US, DEFAULT_MIN_US, ServoMap, default_servo_map
from hexctl.robot.servos.servo_schema import ServosSection
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


def test_ranges_wider_than_the_pulses_are_named(tmp_path: Path) -> None:
    robot = shipped()
    path = edited_file(tmp_path, put("servos", {"tibia": {"offset_deg": 75}}))
    assert joints_beyond(load_robot_file(path).servo_map, robot) == ()
    path = edited_file(
        tmp_path, put("servos", {"leg2_femur": {"offset_deg": 1}, "tibia": {"offset_deg": 75}})
    )
    assert joints_beyond(load_robot_file(path).servo_map, robot) == ("leg2_femur",)


joints = st.integers(0, 17)
degrees = st.floats(-120, 120)


def pulse(servo_map: ServoMap, joint: int, angle_deg: float) -> float:
    return float(servo_map.raw(np.full(18, np.radians(angle_deg)))[joint])


@given(servo_maps(), joints, degrees, degrees)
def test_a_turned_sign_moves_nothing_where_the_joint_stands(
    servo_map: ServoMap, joint: int, at_deg: float, by_deg: float
) -> None:
    after = servo_map.flipped(joint, at_deg)
    assert pulse(after, joint, at_deg) == pytest.approx(pulse(servo_map, joint, at_deg), abs=1e-6)
    there, back = pulse(after, joint, at_deg + by_deg), pulse(servo_map, joint, at_deg - by_deg)
    assert there == pytest.approx(back, abs=1e-6)


@given(servo_maps(), joints, degrees, degrees)
def test_the_pulse_of_the_believed_angle_means_the_true_one(
    servo_map: ServoMap, joint: int, believed_deg: float, true_deg: float
) -> None:
    after = servo_map.referenced(joint, believed_deg, true_deg)
    expected = pulse(servo_map, joint, believed_deg)
    assert pulse(after, joint, true_deg) == pytest.approx(expected, abs=0.001 * servo_map.per_deg[joint])
    others = np.arange(18) != joint
    np.testing.assert_array_equal(after.offsets_deg[others], servo_map.offsets_deg[others])


def test_limits_come_in_any_order_and_not_too_near() -> None:
    after = default_servo_map().limited(4, (2200.4, 800.6))
    assert (after.least[4], after.most[4]) == (801, 2200)
    assert (after.least[3], after.most[3]) == (500, 2500)
    with pytest.raises(InputError, match="1500 and 1520 us"):
        default_servo_map().limited(4, (1500, 1520))
    with pytest.raises(InputError, match="2000 and 2050 counts"):
        bus().limited(3, (2000, 2050))


def test_a_calibration_is_taken_over_and_the_wiring_is_not() -> None:
    section = ServosSection.model_validate({"leg1_coxa": {"id": 40, "offset_deg": 3}})
    found = (
        bus_map_of(ServosSection(), "feetech")
        .referenced(2, 0, 10)
        .calibrated_as(bus_map_of(section, "feetech"))
    )
    assert found.offsets_deg.tolist() == [3.0] + [0.0] * 17
    assert found.ids[0] == 1
    with pytest.raises(InputError, match="us"):
        found.calibrated_as(default_servo_map())


@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [(-60, 60, 0), (-160, 10, -90), (-10, 150, 90), (-15, 15, 0), (5, 45, 25), (-125, 45, 0)],
)
def test_a_joint_is_judged_where_that_is_easy(lower: float, upper: float, expected: float) -> None:
    assert reference_deg(lower, upper) == expected


def bus(driver: str = "feetech", /, **section: Any) -> BusMap:
    return bus_map_of(ServosSection.model_validate(section), driver)


def test_counts_are_as_the_equation_says() -> None:
    made = bus(leg1_coxa={"id": 40, "sign": -1, "offset_deg": 10}, coxa={"sign": 1})
    assert made.ids[0] == 40
    assert made.raw(np.full(18, np.radians(30)))[0] == pytest.approx(2048 + 4096 / 360 * (-30 + 10))
    assert made.raw(np.zeros(18))[1:] == pytest.approx(2048)
    assert bus(leg5_femur={"id": 99}).names(np.arange(18) == 13) == "leg 5 femur (id 99)"


@pytest.mark.parametrize(
    ("driver", "section", "at_deg", "counts"),
    [
        ("dynamixel", {"model": "ax12a"}, 150, 512 + 511.5),
        ("dynamixel", {"model": "ax12a", "tibia": {"model": "ax18a"}}, 150, 512 + 511.5),
        ("lx16a", {"femur": {"model": "hts35h"}, "tibia": {"model": "lx224"}}, 120, 1000),
    ],
)
def test_models_with_the_same_registers_mix(
    driver: str, section: dict[str, Any], at_deg: float, counts: float
) -> None:
    assert bus(driver, **section).raw(np.full(18, np.radians(at_deg))) == pytest.approx(counts)


def pwm(driver: str = "servo2040", /, **section: Any) -> PwmMap:
    return pwm_map_of(ServosSection.model_validate(section), driver)


def test_ids_are_outputs_from_0_on_and_touch_inputs_are_those_of_feet() -> None:
    made = pwm(
        "servo2040",
        leg2_femur={"id": 5},
        leg2_tibia={"id": 4},
        leg1_tibia={"touch": 5},
        leg4_tibia={"touch": 0},
    )
    assert made.outputs.tolist() == [0, 1, 2, 3, 5, 4, *range(6, 18)]
    assert made.touches.tolist() == [5, 1, 2, 0, 4, 3]
    assert made.servo_name(4) == "output 5"
    assert pwm("pca9685", leg1_coxa={"id": 18}).servo_name(0) == "output 18, channel 2 at 0x41"
    assert pwm(femur={"sign": -1}).raw(np.full(18, np.radians(9)))[:3] == pytest.approx([1600, 1400, 1600])


def test_boards_have_addresses_and_oscillators_of_their_own() -> None:
    assert pwm("pca9685").addresses == (0x40, 0x41)
    made = pwm("pca9685", addresses=[0x41, 0x40], oscillator_mhz=26, port=1)
    assert (made.addresses, made.oscillators_mhz) == ((0x41, 0x40), (26.0, 26.0))
    assert pwm("pca9685", oscillator_mhz=[24.5, 26]).oscillators_mhz == (24.5, 26.0)
    assert ServosSection.model_validate({"port": 1}).port == "1"


WRONG_SECTIONS: list[tuple[Any, str]] = [
    ({"leg7_coxa": {}}, r"servos\.leg7_coxa"),
    ({"leg1_coxa": {"chanel": 1}}, r"servos\.leg1_coxa\.chanel.*'channel'"),
    ({"coxa": {"channel": 1}}, r"servos\.coxa\.channel"),
    ({"leg1_coxa": {"channel": 19}}, r"servos\.leg1_coxa\.channel"),
    ({"leg1_coxa": {"channel": 2}}, "channel 2 for leg1_coxa and leg1_femur"),
    ({"leg1_coxa": {"sign": 2}}, r"servos\.leg1_coxa\.sign"),
    ({"leg1_coxa": {"offset_deg": math.nan}}, "offset_deg"),
    ({"leg1_coxa": {"min_us": 2600}}, "min_us 2600 and max_us 2500"),
    ({"us_per_deg": 0}, r"servos\.us_per_deg"),
    ([1], "servos"),
]


@pytest.mark.parametrize(("section", "named"), WRONG_SECTIONS)
def test_a_wrong_section_is_refused_with_its_file_and_key(section: Any, named: str, tmp_path: Path) -> None:
    path = edited_file(tmp_path, put("servos", section))
    with pytest.raises(InputError, match=named) as refused:
        _ = load_robot_file(path).servo_map
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"channels": list(range(1, 19))}, "servos.channels"),
        ({"signs": np.ones(6)}, "servos.signs"),
        ({"offsets_deg": np.full(18, np.nan)}, "servos.offsets_deg"),
    ],
)
def test_a_map_of_wrong_arrays_is_refused(change: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        replace(default_servo_map(), **change)


@pytest.mark.parametrize(
    ("driver", "section", "named"),
    [
        ("feetech", {"leg1_coxa": {"id": 2}}, "id 2 for leg1_coxa and leg1_femur"),
        ("feetech", {"model": "ax12a"}, "ax12a with feetech"),
        ("feetech", {"model": "mg996r"}, "servos.model"),
        ("feetech", {"tibia": {"model": "scs0009"}}, "registers"),
        ("dynamixel", {"driver": "feetech"}, "servos.driver"),
        ("feetech", {"coxa": {"min_count": 3000, "max_count": 2000}}, "min_count"),
        ("dynamixel", {"model": "ax12a", "coxa": {"max_count": 1024}}, "max_count"),
        ("servo2040", {"leg1_coxa": {"id": 18}}, "servos.leg1_coxa.id"),
        ("servo2040", {"leg1_coxa": {"id": 1}}, "id 1 for leg1_coxa and leg1_femur"),
        ("servo2040", {"leg1_tibia": {"touch": 1}}, "touch 1 for leg1_tibia and leg2_tibia"),
        ("servo2040", {"leg1_coxa": {"touch": 1}}, "servos.leg1_coxa"),
        ("servo2040", {"tibia": {"min_us": 400}}, "min_us 400"),
        ("pca9685", {"leg1_coxa": {"id": 32}}, "servos.leg1_coxa.id"),
        ("pca9685", {"leg1_tibia": {"touch": 1}}, "touch 1"),
        ("servo2040", {"driver": "feetech"}, "servos.driver"),
        ("hitec", {}, "servos.driver"),
    ],
)
def test_what_no_bus_and_no_board_can_have_is_refused(
    driver: str, section: dict[str, Any], named: str
) -> None:
    make = bus if driver in BUS_DRIVERS else pwm
    with pytest.raises(InputError, match=named):
        make(driver, **section)


@pytest.mark.parametrize(
    "section",
    [
        {"leg1_coxa": {"id": 253}},
        {"leg1_tibia": {"touch": 6}},
        {"addresses": [0x40, 0x40]},
        {"addresses": [0x40, 0x70]},
        {"addresses": [0x40]},
        {"oscillator_mhz": 19},
        {"oscillator_mhz": [25, 31]},
        {"port": True},
    ],
)
def test_ids_bauds_and_addresses_are_checked_in_the_file(section: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        ServosSection.model_validate(section)
