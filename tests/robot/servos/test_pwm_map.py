"""Which output of a board moves which joint."""

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from hexctl.errors import InputError
from hexctl.robot.schema import ServosSection
from hexctl.robot.servos.pwm_map import PwmMap, pwm_map_of


def _map(driver: str = "servo2040", /, **section: Any) -> PwmMap:
    return pwm_map_of(ServosSection.model_validate(section), driver)


def test_ids_are_outputs_from_0_on_and_touch_inputs_are_those_of_feet() -> None:
    made = _map(
        "servo2040",
        leg2_femur={"id": 5},
        leg2_tibia={"id": 4},
        leg1_tibia={"touch": 5},
        leg4_tibia={"touch": 0},
    )
    assert made.outputs.tolist() == [0, 1, 2, 3, 5, 4, *range(6, 18)]
    assert made.touches.tolist() == [5, 1, 2, 0, 4, 3]
    assert made.servo_name(4) == "output 5"
    assert _map("pca9685", leg1_coxa={"id": 18}).servo_name(0) == "output 18, channel 2 at 0x41"
    assert _map(femur={"sign": -1}).raw(np.full(18, np.radians(9)))[:3] == pytest.approx([1600, 1400, 1600])


@pytest.mark.parametrize(
    ("driver", "section", "message"),
    [
        ("servo2040", {"leg1_coxa": {"id": 18}}, "servos.leg1_coxa.id: got 18; allowed: 0 to 17"),
        (
            "servo2040",
            {"leg1_coxa": {"id": 1}},
            "got id 1 for leg1_coxa and leg1_femur; allowed: each id once",
        ),
        ("servo2040", {"leg1_tibia": {"touch": 1}}, "got touch 1 for leg1_tibia and leg2_tibia"),
        ("servo2040", {"leg1_coxa": {"touch": 1}}, "servos.leg1_coxa: got touch 1; allowed: touch under the"),
        ("servo2040", {"tibia": {"min_us": 400}}, "got min_us 400 and max_us 2500; allowed: 500 to 2500 us"),
        ("pca9685", {"leg1_coxa": {"id": 32}}, "servos.leg1_coxa.id: got 32; allowed: 0 to 31 with pca9685"),
        ("pca9685", {"leg1_tibia": {"touch": 1}}, "got touch 1; allowed: no touch with pca9685"),
        ("servo2040", {"driver": "feetech"}, "servos.driver: got feetech; allowed: servo2040"),
        ("hitec", {}, "servos.driver: got 'hitec'; allowed: servo2040, pca9685"),
    ],
)
def test_what_no_board_can_have_is_refused(driver: str, section: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        _map(driver, **section)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_touch_input_is_one_of_six() -> None:
    with pytest.raises(ValidationError):
        ServosSection.model_validate({"leg1_tibia": {"touch": 6}})


def test_boards_have_addresses_and_oscillators_of_their_own() -> None:
    assert _map("pca9685").addresses == (0x40, 0x41)
    made = _map("pca9685", addresses=[0x41, 0x40], oscillator_mhz=26, port=1)
    assert (made.addresses, made.oscillators_mhz) == ((0x41, 0x40), (26.0, 26.0))
    assert _map("pca9685", oscillator_mhz=[24.5, 26]).oscillators_mhz == (24.5, 26.0)
    assert ServosSection.model_validate({"port": 1}).port == "1"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("addresses", [0x40, 0x40]),
        ("addresses", [0x40, 0x70]),
        ("addresses", [0x40, 0x80]),
        ("addresses", [0x40]),
        ("addresses", 0x40),
        ("oscillator_mhz", 19),
        ("oscillator_mhz", [25, 31]),
        ("oscillator_mhz", True),
        ("port", True),
    ],
)
def test_boards_that_cannot_be_are_refused(key: str, value: object) -> None:
    with pytest.raises(ValidationError):
        ServosSection.model_validate({key: value})
