"""Numbers in the registers of servos."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.bus.registers import AX, STS, XL330, Register, Sign, X, table_of
from hexctl.robot.servos.servo_models import SERVO_TYPES


@pytest.mark.parametrize(
    ("register", "raw", "value"),
    [
        (Register(36, 2), 1023, 1023),
        (AX.effort, 1024 + 512, -512 / 1023),
        (STS.position, 0x8000 | 5, -5),
        (STS.position, 4095, 4095),
        (STS.current, 100, 0.65),
        (STS.voltage, 121, 12.1),
        (X.position, 0xFFFFFFFF, -1),
        (XL330.current, 0x10000 - 250, -0.25),
    ],
)
def test_raw_numbers_are_read_as_the_tables_say(register: Register, raw: int, value: float) -> None:
    assert register.value(raw) == pytest.approx(value)
    assert register.raw(value) == raw


@given(
    sign=st.sampled_from(["none", "twos", "bit10", "bit15"]),
    size=st.sampled_from([2, 4]),
    value=st.integers(-1000, 1000),
)
def test_numbers_come_back(sign: Sign, size: int, value: int) -> None:
    register = Register(0, size, sign)
    value = abs(value) if sign == "none" else value
    assert register.value(register.raw(value)) == value


@pytest.mark.parametrize("model", [name for name, each in SERVO_TYPES.items() if each.driver != "lx16a"])
def test_every_model_has_registers_in_which_its_centre_fits(model: str) -> None:
    table = table_of(model)
    assert table.protocol == SERVO_TYPES[model].protocol
    first, size = table.block
    for register in table.reports:
        assert first <= register.address
        assert register.address + register.size <= first + size
    packed = table.packed(table.goal, SERVO_TYPES[model].centre)
    assert table.goal.value(int.from_bytes(packed, table.byte_order)) == SERVO_TYPES[model].centre
