"""Which servo of a bus moves which joint, and what its counts mean."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from hexctl.errors import InputError
from hexctl.robot.schema import ServosSection
from hexctl.robot.servos.bus_map import BusMap, bus_map_of


def _map(driver: str = "feetech", /, **section: Any) -> BusMap:
    return bus_map_of(ServosSection.model_validate(section), driver)


def test_counts_are_as_the_equation_says() -> None:
    made = _map(leg1_coxa={"id": 40, "sign": -1, "offset_deg": 10}, coxa={"sign": 1})
    assert made.ids[0] == 40
    assert made.raw(np.full(18, np.radians(30)))[0] == pytest.approx(2048 + 4096 / 360 * (-30 + 10))
    assert made.raw(np.zeros(18))[1:] == pytest.approx(2048)
    arc = _map("dynamixel", model="ax12a")
    assert arc.raw(np.full(18, np.radians(150))) == pytest.approx(512 + 511.5)


@given(
    degrees=st.lists(st.floats(-90, 90), min_size=18, max_size=18),
    sign=st.sampled_from([1, -1]),
    offset=st.floats(-30, 30),
)
def test_angles_come_back(degrees: list[float], sign: int, offset: float) -> None:
    made = _map(coxa={"sign": sign, "offset_deg": offset})
    angles = np.radians(degrees)
    assert made.angles_rad(made.raw(angles)) == pytest.approx(angles, abs=1e-9)
    limited = made.limited_rad(angles)
    assert not made.outside(limited).any()


def test_limits_of_a_joint_come_before_those_of_its_kind() -> None:
    made = _map(femur={"min_count": 1000, "max_count": 3000}, leg2_femur={"max_count": 2500})
    assert (made.least[1], made.most[1], made.most[4]) == (1000, 3000, 2500)
    high = made.limited_rad(np.full(18, np.radians(170)))
    assert made.raw(high)[[1, 4]] == pytest.approx([3000, 2500])


def test_all_servos_of_the_lx16a_family_mix() -> None:
    made = _map("lx16a", femur={"model": "hts35h"}, tibia={"model": "lx224"})
    assert made.raw(np.full(18, np.radians(120))) == pytest.approx(1000)


def test_models_with_the_same_registers_mix() -> None:
    mixed = _map("dynamixel", model="ax12a", tibia={"model": "ax18a"})
    assert {model.name for model in mixed.models} == {"ax12a", "ax18a"}


def test_joints_are_named_with_their_ids() -> None:
    made = _map(leg5_femur={"id": 99})
    assert made.names(np.arange(18) == 13) == "leg 5 femur (id 99)"


@pytest.mark.parametrize(
    ("driver", "section", "message"),
    [
        ("feetech", {"leg1_coxa": {"id": 2}}, "got id 2 for leg1_coxa and leg1_femur; allowed: each id once"),
        ("feetech", {"model": "ax12a"}, "got ax12a with feetech; allowed: models of feetech"),
        ("feetech", {"model": "mg996r"}, "servos.model: got 'mg996r'; allowed: ax12a, "),
        ("feetech", {"tibia": {"model": "scs0009"}}, "allowed: models with the same registers"),
        ("dynamixel", {"driver": "feetech"}, "servos.driver: got feetech; allowed: dynamixel"),
        ("feetech", {"coxa": {"min_count": 3000, "max_count": 2000}}, "allowed: min_count below max_count"),
        ("dynamixel", {"model": "ax12a", "coxa": {"max_count": 1024}}, "max_count from 0 to 1023 (ax12a)"),
    ],
)
def test_what_no_bus_can_have_is_refused(driver: str, section: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        _map(driver, **section)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("section", [{"leg1_coxa": {"id": 253}}, {"baud": 10}, {"driver": "hitec"}])
def test_ids_bauds_and_drivers_are_checked_in_the_file(section: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        ServosSection.model_validate(section)
