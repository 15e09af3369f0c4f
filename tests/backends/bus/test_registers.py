"""Registers, commands and voltages against the vendors' own tables, row by row."""

import math
from collections.abc import Iterator
from dataclasses import fields
from importlib.resources import files
from typing import Any

import pytest

from hexctl.backends.bus.families import lx16a
from hexctl.backends.bus.families.registers import FactoryValue, Register, RegisterTable, RequiredValue
from tests.backends.bus.boards import MODELS_BY_NAME

#: Address and size by the vendor's name of a row.
Rows = dict[str, tuple[int, int]]

#: AX-12A and AX-18A: ROBOTIS e-Manual, "Control Table of EEPROM Area" and "of RAM Area".
AX_ROWS = """
0 2 Model Number; 2 1 Firmware Version; 3 1 ID; 5 1 Return Delay Time; 6 2 CW Angle Limit; 8 2 CCW Angle Limit
12 1 Min Voltage Limit; 13 1 Max Voltage Limit; 14 2 Max Torque; 16 1 Status Return Level; 18 1 Shutdown
24 1 Torque Enable; 26 1 CW Compliance Margin; 27 1 CCW Compliance Margin; 28 1 CW Compliance Slope
29 1 CCW Compliance Slope; 48 2 Punch; 30 2 Goal Position; 32 2 Moving Speed; 34 2 Torque Limit
36 2 Present Position; 40 2 Present Load; 42 1 Present Voltage; 43 1 Present Temperature
"""

#: STS and SCS: Feetech's memory tables, as LeRobot lists them (motors/feetech/tables.py).
FEETECH_ROWS = """
0 1 Firmware Major; 1 1 Firmware Minor; 3 2 Model Number; 5 1 ID; 7 1 Return Delay Time; 8 1 Response Level
9 2 Min Angle Limit; 11 2 Max Angle Limit; 14 1 Max Voltage Limit; 15 1 Min Voltage Limit; 16 2 Max Torque
18 1 Phase; 19 1 Unloading Condition; 21 1 P; 22 1 D; 23 1 I; 24 2 Minimum Startup Force; 26 1 CW Dead Zone
27 1 CCW Dead Zone; 31 2 Homing Offset; 40 1 Torque Enable; 42 2 Goal Position; 46 2 Goal Speed
56 2 Present Position; 60 2 Present Load; 62 1 Present Voltage; 63 1 Present Temperature
"""
STS_ROWS = """
30 1 Angular Resolution; 33 1 Mode; 34 1 Protective Torque; 41 1 Acc; 48 2 Torque Limit; 55 1 Lock
69 2 Present Current
"""


def pairs(text: str) -> dict[str, str]:
    """Text by its first words: `field Name in the table`, between semicolons or in lines."""
    words = (part.split(None, 1) for part in text.replace(";", "\n").splitlines() if part.strip())
    return {key: value.strip() for key, value in words}


#: The vendors' names of the registers of each field, in its order.
DYNAMIXEL = pairs("""
torque Torque Enable; goal Goal Position; position Present Position; effort Present Load
current Present Current; temperature Present Temperature; model Model Number; servo_id ID
return_delay Return Delay Time; status_level Status Return Level; firmware Firmware Version
voltages Min Voltage Limit, Max Voltage Limit; shutdown Shutdown; hardware_error Hardware Error Status
""")
AX_NAMES = DYNAMIXEL | pairs("""
voltage Present Voltage; least CW Angle Limit; most CCW Angle Limit; mode Control Mode; speed Moving Speed
max_torque Max Torque; torque_limit Torque Limit; soft_torque Torque Limit
tuning CW Compliance Margin, CCW Compliance Margin, CW Compliance Slope, CCW Compliance Slope, Punch
""")
XL320_NAMES = AX_NAMES | pairs("p_gain P Gain; tuning P Gain, I Gain, D Gain")
X_NAMES = DYNAMIXEL | pairs("""
voltage Present Input Voltage; least Min Position Limit; most Max Position Limit; mode Operating Mode
also_required Drive Mode, Profile Acceleration, Profile Velocity, Drive Mode, Drive Mode
shadow_id Secondary(Shadow) ID; max_torque PWM Limit; soft_torque Goal PWM; speed Profile Velocity
acceleration Profile Acceleration; watchdog Bus Watchdog; p_gain Position P Gain; offset Homing Offset
tuning Position P Gain, Position D Gain, Position I Gain, Feedforward 2nd Gain, Feedforward 1st Gain
""")
FEETECH_NAMES = DYNAMIXEL | pairs("""
voltage Present Voltage; least Min Angle Limit; most Max Angle Limit; mode Mode; slow_unit Phase
also_required Phase, Phase, Angular Resolution; status_level Response Level; speed Goal Speed
firmware Firmware Major, Firmware Minor; shutdown Unloading Condition; overload_torque Protective Torque
max_torque Max Torque; torque_limit Torque Limit; soft_torque Torque Limit; acceleration Acc; unlock Lock
offset Homing Offset; p_gain P; tuning P, D, I, Minimum Startup Force, CW Dead Zone, CCW Dead Zone
""")

#: Units of a count in the e-Manual and Feetech's tables: A, V, degrees/s and degrees/s^2.
UNITS = {
    "ax": {"voltage": 0.1, "speed": 0.111 * 6},
    "xl320": {"voltage": 0.1, "speed": 0.111 * 6},
    "xl330": {"voltage": 0.1, "current": 0.001, "speed": 0.229 * 6, "acceleration": 214.577 / 10},
    "xl430": {"voltage": 0.1, "speed": 0.229 * 6, "acceleration": 214.577 / 10},
    "xm430": {"voltage": 0.1, "current": 0.00269, "speed": 0.229 * 6, "acceleration": 214.577 / 10},
    "sts": {"voltage": 0.1, "current": 0.0065, "speed": 360 / 4096, "acceleration": 36000 / 4096},
    "scs": {"voltage": 0.1, "speed": 300 / 1023},
}

#: Initial values of the settings in `tuning`: e-Manual, "Control Table of RAM Area", and Feetech's tables.
FACTORY = {
    "ax": [1, 1, 32, 32, 32],
    "xl320": [32, 0, 0],
    "xl330": [400, 0, 0, 0, 0],
    "xl430": [640, 4000, 0, 0, 0],
    "xm430": [800, 0, 0, 0, 0],
    "sts": [32, 32, 0, 16, 1, 1],
    "scs": [],
}

#: Lowest supply in V.
LEAST_V = pairs("""
ax12a 9; ax18a 9; xl320 6; xl330-m077 3.7; xl330-m288 3.7; xl430-w250 6.5; xm430-w350 10; sts3215 4; sts3032 4
scs0009 4.8; lx16a 6; lx224 6; hts35h 9
""")


def rows_of(text: str) -> Rows:
    """Rows as they are printed above, or in the files of the Dynamixel SDK."""
    lines = [line.split(None, 2) for line in text.replace(";", "\n").splitlines() if line.strip()]
    return {name: (int(address), int(size)) for address, size, name in lines}


def dynamixel_rows(model: str) -> Rows:
    """The control table of a model in the vendor's SDK."""
    text = (files("dynamixel_easy_sdk") / "control_table" / f"{model}.model").read_text()
    return rows_of(text.partition("[control table]\nAddress\tSize\tData Name\n")[2])


STS, SCS = rows_of(FEETECH_ROWS) | rows_of(STS_ROWS), rows_of(FEETECH_ROWS) | {"Lock": (48, 1)}

VENDORS = {
    "ax12a": (rows_of(AX_ROWS), AX_NAMES),
    "ax18a": (rows_of(AX_ROWS), AX_NAMES),
    "xl320": (dynamixel_rows("xl320"), XL320_NAMES),
    "xl330-m077": (dynamixel_rows("xl330_m077"), X_NAMES),
    "xl330-m288": (dynamixel_rows("xl330_m288"), X_NAMES),
    "xl430-w250": (dynamixel_rows("xl430_w250"), X_NAMES),
    "xm430-w350": (dynamixel_rows("xm430_w350"), X_NAMES),
    "sts3215": (STS, FEETECH_NAMES),
    "sts3032": (STS, FEETECH_NAMES),
    "scs0009": (SCS, FEETECH_NAMES),
}


def registers(value: Any) -> Iterator[Register]:
    """The registers in a field of a table."""
    if isinstance(value, Register):
        yield value
    elif isinstance(value, FactoryValue):
        yield value.register
    elif isinstance(value, RequiredValue):
        yield from (value.register, *value.then_zero)
    elif isinstance(value, tuple):
        for each in value:
            yield from registers(each)


def named(table: RegisterTable) -> dict[str, list[Register]]:
    """The registers of each field of a table that has some."""
    found = {each.name: list(registers(getattr(table, each.name))) for each in fields(table)}
    return {name: some for name, some in found.items() if some}


@pytest.mark.parametrize("model", VENDORS)
def test_every_register_is_where_the_vendors_table_has_it(model: str) -> None:
    rows, names = VENDORS[model]
    table = MODELS_BY_NAME[model].table
    for field, some in named(table).items():
        assert field in names, f"{field} needs its name in the vendor's table here"
        expected = [rows[name.strip()] for name in names[field].split(",")]
        assert [(each.address, each.size) for each in some] == expected, field
    for field, unit in next(units for begin, units in UNITS.items() if model.startswith(begin)).items():
        assert getattr(table, field).scale == pytest.approx(unit, rel=2e-3), field
    (factory,) = (values for begin, values in FACTORY.items() if model.startswith(begin))
    assert [each.value for each in table.tuning] == factory
    if table.p_gain is not None and factory:
        most = 254 if table.p_gain.size == 1 else 16_383
        assert MODELS_BY_NAME[model].p_gains == (math.ceil(factory[0] / 10), min(10 * factory[0], most))
    first_volatile = min(address for address, _ in (rows["Torque Enable"], rows["Goal Position"]))
    assert table.ram == first_volatile


@pytest.mark.parametrize(("prefix", "rows"), [("SMS_STS", STS), ("SCSCL", SCS)])
def test_the_feetech_sdk_has_the_same_rows(prefix: str, rows: Rows) -> None:
    """It names some of the registers, those of two bytes by their first."""
    import scservo_sdk

    words = {
        name: f"{prefix}_{name.upper().replace(' ', '_')}{'_L' if size == 2 else ''}"
        for name, (_, size) in rows.items()
    }
    named_there = {
        name: vars(scservo_sdk)[word] for name, word in words.items() if hasattr(scservo_sdk, word)
    }
    assert len(named_there) >= 10
    assert named_there == {name: rows[name][0] for name in named_there}


def test_the_commands_of_lx16a_are_those_of_its_document() -> None:
    """LewanSoul Bus Servo Communication Protocol, table of commands with the length of each packet."""
    written = {1: 7, 13: 4, 20: 7, 29: 7, 31: 4}
    answered = {14: 4, 19: 4, 21: 7, 23: 7, 25: 4, 26: 4, 27: 5, 28: 5, 30: 7, 32: 4}
    head = 3  # length, command and sum
    assert {command: size + head for command, size in lx16a.WRITE_BYTES.items()} == written
    assert {command: size + head for command, size in lx16a.ANSWER_BYTES.items()} == answered
    by_name = [lx16a.MOVE, lx16a.WRITE_ID, lx16a.WRITE_LIMITS, lx16a.WRITE_MODE, lx16a.WRITE_LOAD]
    assert by_name == list(written)
    asked = "ID OFFSET LIMITS VOLTAGE_LIMITS MOST_TEMPERATURE TEMPERATURE VOLTAGE POSITION MODE LOAD"
    assert [getattr(lx16a, f"READ_{name}") for name in asked.split()] == list(answered)


def test_supplies_numbers_and_turns_are_those_of_the_data_sheets() -> None:
    """Lowest supply in V, model number and counts: e-Manual, "Specifications", and product pages."""
    assert {name: f"{each.least_v:g}" for name, each in MODELS_BY_NAME.items()} == LEAST_V
    numbers = {"ax12a": 12, "ax18a": 18, "sts3215": 777, "scs0009": 1284}
    for line in (
        (files("dynamixel_easy_sdk") / "control_table" / "dynamixel.model").read_text().split("\n")[1:]
    ):
        number, _, name = line.strip().partition("\t")
        numbers |= {name.removesuffix(".model").replace("_", "-"): int(number)} if name else {}
    reported = {name: each.number for name, each in MODELS_BY_NAME.items() if each.number is not None}
    assert reported == {name: numbers[name] for name in reported}
    per_degree = {
        "ax": 1023 / 300,
        "xl320": 1023 / 300,
        "scs0009": 1023 / 300,
        "lx": 1000 / 240,
        "hts": 1000 / 240,
    }
    for name, each in MODELS_BY_NAME.items():
        counts = next((value for begin, value in per_degree.items() if name.startswith(begin)), 4096 / 360)
        assert each.counts_per_deg == pytest.approx(counts), name
