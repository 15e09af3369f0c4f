"""What raw positions of servos mean as angles, and what calibration changes of it."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot_file
from hexctl.robot.schema import ServosSection
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.robot.servos.raw_map import joints_beyond, reference_deg
from hexctl.robot.servos.servo_map import ServoMap, default_servo_map
from tests.robot.servos.test_servo_map import servo_maps
from tests.robots import edited_file, put, shipped


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
    with pytest.raises(InputError, match="got 1500 and 1520 us; allowed: 50 us apart"):
        default_servo_map().limited(4, (1500, 1520))


def test_counts_are_calibrated_as_pulses_are() -> None:
    bus_map = bus_map_of(ServosSection(), "feetech")
    after = bus_map.flipped(3, 10).referenced(3, 10, 20).limited(3, (3000, 1000))
    assert (after.signs[3], after.offsets_deg[3], after.least[3], after.most[3]) == (-1, 30, 1000, 3000)
    before, now = (made.raw(np.radians([at_deg] * 18))[3] for made, at_deg in ((bus_map, 10), (after, 20)))
    assert now == pytest.approx(before)
    with pytest.raises(InputError, match="got 2000 and 2050 counts; allowed: 51 counts apart"):
        bus_map.limited(3, (2000, 2050))


def test_a_calibration_is_taken_over_and_the_wiring_is_not() -> None:
    section = ServosSection.model_validate({"leg1_coxa": {"id": 40, "offset_deg": 3}})
    found = (
        bus_map_of(ServosSection(), "feetech")
        .referenced(2, 0, 10)
        .calibrated_as(bus_map_of(section, "feetech"))
    )
    assert found.offsets_deg.tolist() == [3.0] + [0.0] * 17
    assert found.ids[0] == 1
    with pytest.raises(InputError, match="got one in us; allowed: in counts"):
        found.calibrated_as(default_servo_map())


@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [(-60, 60, 0), (-160, 10, -90), (-10, 150, 90), (-15, 15, 0), (5, 45, 25), (-125, 45, 0)],
)
def test_a_joint_is_judged_where_that_is_easy(lower: float, upper: float, expected: float) -> None:
    assert reference_deg(lower, upper) == expected
