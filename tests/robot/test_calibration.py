"""What answers about a servo make of its map."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.robot.calibration import flipped, limited, reference_deg, referenced, taken_over
from hexctl.robot.servomap import ServoMap, default_servo_map
from tests.robot.test_servomap import servo_maps

joints = st.integers(0, 17)
degrees = st.floats(-120, 120)


def pulse(servo_map: ServoMap, joint: int, angle_deg: float) -> float:
    return float(servo_map.pulses_us(np.full(18, np.radians(angle_deg)))[joint])


@given(servo_maps(), joints, degrees, degrees)
def test_a_turned_sign_moves_nothing_where_the_joint_stands(
    servo_map: ServoMap, joint: int, at_deg: float, by_deg: float
) -> None:
    after = flipped(servo_map, joint, at_deg)
    assert pulse(after, joint, at_deg) == pytest.approx(pulse(servo_map, joint, at_deg), abs=1e-6)
    there, back = pulse(after, joint, at_deg + by_deg), pulse(servo_map, joint, at_deg - by_deg)
    assert there == pytest.approx(back, abs=1e-6)


@given(servo_maps(), joints, degrees, degrees)
def test_the_pulse_of_the_believed_angle_means_the_true_one(
    servo_map: ServoMap, joint: int, believed_deg: float, true_deg: float
) -> None:
    after = referenced(servo_map, joint, believed_deg, true_deg)
    expected = pulse(servo_map, joint, believed_deg)
    assert pulse(after, joint, true_deg) == pytest.approx(expected, abs=0.001 * servo_map.us_per_deg)
    others = np.arange(18) != joint
    np.testing.assert_array_equal(after.offsets_deg[others], servo_map.offsets_deg[others])


def test_limits_come_in_any_order_and_not_too_near() -> None:
    after = limited(default_servo_map(), 4, (2200.4, 800.6))
    assert (after.min_us[4], after.max_us[4]) == (801, 2200)
    assert (after.min_us[3], after.max_us[3]) == (500, 2500)
    with pytest.raises(InputError, match="got 1500 and 1520 us; allowed: 50 us apart"):
        limited(default_servo_map(), 4, (1500, 1520))


def test_one_joint_is_taken_over_and_no_other() -> None:
    source = referenced(referenced(default_servo_map(), 2, 0, 10), 5, 0, 10)
    assert taken_over(default_servo_map(), 5, source).offsets_deg.tolist() == [0] * 5 + [-10.0] + [0] * 12


@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [(-60, 60, 0), (-160, 10, -90), (-10, 150, 90), (-15, 15, 0), (5, 45, 25), (-125, 45, 0)],
)
def test_a_joint_is_judged_where_that_is_easy(lower: float, upper: float, expected: float) -> None:
    assert reference_deg(lower, upper) == expected
