"""Servo maps: which servo moves which joint, what its raw values mean, and what a calibration writes."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hexctl.backends.bus.bus_map import BusMap, bus_map_of
from hexctl.backends.pwm.pca9685 import settings_of
from hexctl.backends.pwm.pulse_board import pwm_map_of
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.backends.registry import raw_map_of
from hexctl.errors import InputError
from hexctl.robot.configs import config_root, read_mapping
from hexctl.robot.loader import load_robot, load_robot_file
from hexctl.robot.servos.raw_map import RawMap, reference_deg
from hexctl.robot.servos.servo_map import DEFAULT_MAX_US, DEFAULT_MIN_US, ServoMap, default_servo_map
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.robot.servos.servos_section import back_up, check_writable, write_joint
from hexctl.types import JOINT_KINDS, JOINT_NAMES, N_JOINTS
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
def test_every_channel_is_one_joint_within_its_limits(
    servo_map: ServoMap, positions: np.ndarray[Any, Any]
) -> None:
    pulses = servo_map.to_us(positions)[servo_map.channels - 1]
    assert ((servo_map.least <= pulses) & (pulses <= servo_map.most)).all()
    assert servo_map.outside(positions).any() == (~np.isclose(pulses, servo_map.raw(positions))).any()
    for joint, found in enumerate(pulses):
        degrees = servo_map.signs[joint] * math.degrees(positions[joint]) + servo_map.offsets_deg[joint]
        wanted = servo_map.centre[joint] + servo_map.per_deg[joint] * degrees
        assert found == pytest.approx(min(max(wanted, servo_map.least[joint]), servo_map.most[joint]))


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
    servo_map: ServoMap, joint: int, assumed_deg: float, true_deg: float
) -> None:
    after = servo_map.referenced(joint, assumed_deg, true_deg)
    expected = pulse(servo_map, joint, assumed_deg)
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
    assert settings_of(pwm("pca9685")).addresses == (0x40, 0x41)
    made = settings_of(pwm("pca9685", addresses=[0x41, 0x40], oscillator_mhz=26, port=1))
    assert (made.addresses, made.oscillators_mhz) == ((0x41, 0x40), (26.0, 26.0))
    assert settings_of(pwm("pca9685", oscillator_mhz=[24.5, 26])).oscillators_mhz == (24.5, 26.0)
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
    ({"driver": "feetech", "leg1_coxa": {"id": 1e30}}, r"leg1_coxa\.id: got 1e\+30; allowed: a whole number"),
    ({"driver": "feetech", "leg1_coxa": {"id": 253}}, r"servos\.leg1_coxa\.id"),
    ({"driver": "feetech", "leg1_coxa": {"id": 2}}, "id 2 for leg1_coxa and leg1_femur"),
    ({"driver": "feetech", "model": "ax12a"}, "ax12a with feetech"),
    ({"driver": "feetech", "model": "mg996r"}, r"servos\.model"),
    ({"driver": "feetech", "tibia": {"model": "scs0009"}}, "registers"),
    ({"driver": "feetech", "coxa": {"min_count": 3000, "max_count": 2000}}, "min_count"),
    ({"driver": "dynamixel", "model": "ax12a", "coxa": {"max_count": 1024}}, "max_count"),
    ({"driver": "servo2040", "leg1_coxa": {"id": 18}}, r"servos\.leg1_coxa\.id"),
    ({"driver": "servo2040", "leg1_coxa": {"id": 1}}, "id 1 for leg1_coxa and leg1_femur"),
    ({"driver": "servo2040", "leg1_tibia": {"touch": 1}}, "touch 1 for leg1_tibia and leg2_tibia"),
    ({"driver": "servo2040", "leg1_tibia": {"touch": 6}}, r"servos\.leg1_tibia\.touch"),
    ({"driver": "servo2040", "leg1_coxa": {"touch": 1}}, r"servos\.leg1_coxa"),
    ({"driver": "servo2040", "tibia": {"min_us": 400}}, "min_us 400"),
    ({"driver": "pca9685", "leg1_coxa": {"id": 32}}, r"servos\.leg1_coxa\.id"),
    ({"driver": "pca9685", "leg1_tibia": {"touch": 1}}, r"leg1_tibia\.touch: got 1; allowed: no touch"),
    ({"driver": "pca9685", "board": {"crc": True}}, r"servos\.board: got crc"),
    *(({"addresses": wrong}, r"servos\.addresses") for wrong in ([0x40, 0x40], [0x40, 0x70], [0x40])),
    *(({"oscillator_mhz": wrong}, r"servos\.oscillator_mhz") for wrong in (19, [25, 31])),
    ({"port": True}, r"servos\.port"),
    ({"driver": "feetech", "p_gain": 32}, r"servos\.p_gain"),
]


@pytest.mark.parametrize(("section", "named"), WRONG_SECTIONS)
def test_a_wrong_section_is_refused_with_its_file_and_key(section: Any, named: str, tmp_path: Path) -> None:
    path = edited_file(tmp_path, put("servos", section))
    with pytest.raises(InputError, match=named) as refused:
        _ = raw_map_of(load_robot_file(path))
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


def test_a_p_gain_that_is_none_of_its_servos_is_refused(tmp_path: Path) -> None:
    def loaded(driver: str, model: str, p_gain: float) -> RawMap:
        edits = put("servo", "p_gain", p_gain), put("servos", {"driver": driver, "model": model})
        return raw_map_of(load_robot_file(edited_file(tmp_path, *edits, base="lukas")))

    sts, xl430 = ("feetech", "sts3215"), ("dynamixel", "xl430-w250")
    for kind, p_gain in ((sts, 16), (xl430, 640), (("dynamixel", "ax12a"), 640)):
        assert getattr(loaded(*kind, p_gain), "p_gain", None) == p_gain
    for kind, wrong in (*((sts, each) for each in (0, 0.3, 31.6, -32, True, 3, 255)), (xl430, 32)):
        with pytest.raises(InputError, match=r"servo\.p_gain"):
            loaded(*kind, wrong)


def test_a_section_of_another_driver_and_arrays_of_another_shape_are_refused() -> None:
    for make, driver in ((bus, "dynamixel"), (pwm, "servo2040")):
        with pytest.raises(InputError, match=r"servos\.driver"):
            make(driver, driver="feetech")
    with pytest.raises(InputError, match=r"driver: got 'hitec'"):
        bus("hitec")
    with pytest.raises(InputError, match=r"servos\.signs"):
        replace(default_servo_map(), signs=np.ones(6))


# What a calibration writes into a robot file: one joint, and no other key or comment.

ANT = config_root() / "robots" / "ant.yaml"

SHIPPED = "".join(
    line
    for line in ANT.read_text(encoding="utf-8").splitlines(keepends=True)
    if not line.startswith("servos")
)

#: Section by layout, each with another joint in front of leg1_tibia's keys or none.
SECTIONS = {
    "none": SHIPPED,
    "flow": SHIPPED + "servos: {tibia: {offset_deg: 75}} # mine\n",
    "flow, the joint in it": SHIPPED + "servos: {leg1_tibia: {offset_deg: 75, }, } # mine\n",
    "flow over lines": SHIPPED + "servos: {tibia: {offset_deg: 75},\n  coxa: {sign: -1}\n}\n",
    "block in the middle": SHIPPED.replace(
        "foot_radius_m:",
        "servos:\n  # the tibias\n  tibia:\n    offset_deg: 75 # horn\n\n# about the feet\nfoot_radius_m:",
    ),
    "block at the end": SHIPPED + "servos:\n  tibia: {offset_deg: 75}\n\n# the end\n",
    "the joint in it": SHIPPED
    + "servos:\n  port: /dev/x # usb\n  leg1_tibia: # mine\n    # horn\n    offset_deg: 75 # slipped\n"
    "    channel: 3\n  # the hips\n  coxa: {sign: -1}\n",
    "the joint last": SHIPPED + "servos:\n    leg1_tibia:\n        sign: -1",
    "the joint in flow": SHIPPED
    + "servos:\n  leg1_tibia: {channel: 3, sign: -1} # mine\n  coxa: {sign: 1}\n",
    "empty": SHIPPED + "servos: {}\n",
    "before others": "servos:\n  tibia:\n    offset_deg: 75\n" + SHIPPED,
}


@pytest.mark.parametrize("kind", SECTIONS)
def test_one_joint_changes_and_every_other_line_stays(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(SECTIONS[kind], encoding="utf-8")
    before = read_mapping(path)
    wanted = default_servo_map().flipped(2, 10).limited(2, (700, 1900))
    write_joint(path, wanted, 2)
    expected = before.setdefault("servos", {}).setdefault("leg1_tibia", {})
    expected |= {"sign": -1, "offset_deg": 20.0, "min_us": 700, "max_us": 1900}
    assert read_mapping(path) == before
    assert load_robot(path).fingerprint == shipped().fingerprint
    written = path.read_text(encoding="utf-8")
    for comment in ("about the feet", "the end", "the tibias", "horn", "mine", "usb", "slipped"):
        assert (f"# {comment}" in written) == (f"# {comment}" in SECTIONS[kind])
    kept = [line for line in SHIPPED.splitlines() if line]
    assert [line for line in written.splitlines() if line in kept] == kept
    assert list(tmp_path.iterdir()) == [path]


def test_joints_that_share_keys_by_anchors_are_told_apart(tmp_path: Path) -> None:
    """Both have the keys of the first, until one of them is calibrated."""
    path = tmp_path / "mine.yaml"
    path.write_text(
        SHIPPED + "# wiring\nservos:\n  leg1_coxa: &right {sign: -1, offset_deg: 2}\n  leg2_coxa: *right\n",
        encoding="utf-8",
    )
    write_joint(path, default_servo_map().referenced(3, 0, 5), 3)
    found = load_robot_file(path).servo_map
    assert (found.signs[0], found.offsets_deg[0]) == (-1, 2)
    assert (found.signs[3], found.offsets_deg[3]) == (1, -5)
    assert "# wiring\n" in path.read_text(encoding="utf-8")


keys = {
    "sign": st.sampled_from([1, -1]),
    "offset_deg": st.floats(-90, 90).map(lambda value: round(value, 3)),
    "model": st.sampled_from(["sts3215", "sts3032"]),
    "min_count": st.integers(0, 2000),
    "max_count": st.integers(2100, 4095),
    "min_us": st.integers(500, 1400),
    "max_us": st.integers(1500, 2500),
}

kinds = st.fixed_dictionaries({}, optional=keys)


@st.composite
def sections(draw: st.DrawFn) -> dict[str, Any]:
    """Sections `servos` of robots on a bus, with any keys that they may have."""
    ids = draw(st.permutations(range(30)))
    wiring = {"touch": st.integers(0, 5), "channel": st.integers(1, 18)}
    joints = {
        name: st.fixed_dictionaries({"id": st.just(ids[joint])}, optional={**keys, **wiring})
        for joint, name in enumerate(JOINT_NAMES)
    }
    common = {
        "driver": st.just("feetech"),
        "port": st.sampled_from(["/dev/ttyUSB0", "/dev/serial/by-path/a: b", "#1", "''"]),
        "baud": st.sampled_from([115200, 1_000_000]),
        "model": st.just("sts3215"),
        "if_computer_dies": st.sampled_from(["sit", "hold"]),
        "us_per_deg": st.floats(1, 30),
        "centre_us": st.integers(1000, 2000),
        "low_battery_v": st.floats(1, 20),
    }
    made = draw(st.fixed_dictionaries({}, optional={**common, **dict.fromkeys(JOINT_KINDS, kinds), **joints}))
    return dict(draw(st.permutations(list(made.items()))))


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=12, deadline=None)
@given(sections(), st.sampled_from([None, True, False]), st.permutations(range(18)))
def test_no_key_of_any_section_is_lost(
    tmp_path: Path, section: dict[str, Any], flow: bool | None, joints: list[int]
) -> None:
    path = tmp_path / "mine.yaml"
    text = yaml.safe_dump(section if flow else {"servos": section}, default_flow_style=flow, sort_keys=False)
    path.write_text(("servos: " if flow else "") + text + SHIPPED, encoding="utf-8")
    expected = read_mapping(path)
    found: RawMap = bus_map_of(ServosSection(), "feetech")
    for joint in joints[:3]:
        found = found.referenced(joint, 0, 1.5 * joint).flipped(joint, -joint).limited(joint, (1000, 3000))
        write_joint(path, found, joint)
        expected["servos"].setdefault(JOINT_NAMES[joint], {}).update(
            sign=int(found.signs[joint]),
            offset_deg=float(found.offsets_deg[joint]),
            min_count=1000,
            max_count=3000,
        )
    assert read_mapping(path) == expected
    assert path.read_text().endswith(SHIPPED)


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=2, deadline=None)
@given(servo_maps())
def test_what_is_written_is_read_back_to_the_last_bit(tmp_path: Path, servo_map: ServoMap) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(SHIPPED, encoding="utf-8")
    for joint in [*range(18), 4]:
        write_joint(path, servo_map, joint)
    found = load_robot_file(path).servo_map
    assert found == found.calibrated_as(servo_map)


def test_a_file_that_would_not_load_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(SHIPPED + "servos: {leg1_coxa: {chanel: 1}}\n", encoding="utf-8")
    before = path.read_text()
    with pytest.raises(InputError, match=r"servos.leg1_coxa.chanel"):
        write_joint(path, default_servo_map(), 0)
    assert path.read_text() == before


def test_a_backup_never_takes_the_place_of_an_older_one(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    for content in ("one", "two", "three"):
        path.write_text(content)
        back_up(path)
    kept = {file.name: file.read_text() for file in tmp_path.iterdir()}
    assert kept == {
        "mine.yaml": "three",
        "mine.yaml.bak": "one",
        "mine.yaml.bak.2": "two",
        "mine.yaml.bak.3": "three",
    }


def test_a_file_that_is_a_link_keeps_being_one(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    real, link = tmp_path / "there" / "real.yaml", tmp_path / "link.yaml"
    real.write_text(SHIPPED, encoding="utf-8")
    link.symlink_to(real)
    with pytest.raises(InputError, match="ant"):
        check_writable(ANT)
    write_joint(link, default_servo_map(), 0)
    assert link.is_symlink()
    assert "servos:" in real.read_text(encoding="utf-8")


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
