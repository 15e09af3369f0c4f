"""The servo map: pulses and angles, what calibration changes of it, and its section of a robot file."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.robot.configs import config_root
from hexctl.robot.loader import load_robot, load_servo_map
from hexctl.robot.servo_map import (
    DEFAULT_MAX_US,
    DEFAULT_MIN_US,
    ServoMap,
    back_up,
    check_writable,
    default_servo_map,
    flipped,
    joints_beyond_pulses,
    limited,
    reference_deg,
    referenced,
    taken_over,
    write_servo_map,
)
from hexctl.types import JOINT_NAMES, N_JOINTS
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
        min_us=least,
        max_us=least + draw(st.integers(100, 3000)),
        us_per_deg=draw(st.floats(1, 30)),
        centre_us=draw(st.floats(1000, 2000)),
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
    assert (pulses >= servo_map.min_us).all()
    assert (pulses <= servo_map.max_us).all()
    assert servo_map.outside(positions).any() == (~np.isclose(pulses, servo_map.pulses_us(positions))).any()


@given(servo_maps(), angles)
def test_every_channel_is_one_joint(servo_map: ServoMap, positions: np.ndarray[Any, Any]) -> None:
    for joint, channel in enumerate(servo_map.channels.tolist()):
        degrees = servo_map.signs[joint] * math.degrees(positions[joint]) + servo_map.offsets_deg[joint]
        wanted = servo_map.centre_us + servo_map.us_per_deg * degrees
        expected = min(max(wanted, servo_map.min_us[joint]), servo_map.max_us[joint])
        assert servo_map.to_us(positions)[channel - 1] == pytest.approx(expected)


def test_without_a_section_ninety_degrees_are_a_thousand_microseconds() -> None:
    servo_map = default_servo_map()
    positions = np.zeros(N_JOINTS)
    positions[0], positions[17] = math.radians(90), math.radians(-45)
    np.testing.assert_allclose(servo_map.to_us(positions), [2500, *[1500] * 16, 1000])
    assert (servo_map.min_us[0], servo_map.max_us[0]) == (DEFAULT_MIN_US, DEFAULT_MAX_US)


def test_a_joint_goes_before_its_kind_and_that_before_the_defaults(tmp_path: Path) -> None:
    section = {
        "us_per_deg": 10,
        "centre_us": 1520,
        "low_battery_v": 9.9,
        "tibia": {"offset_deg": 75, "sign": -1},
        "leg1_tibia": {"offset_deg": 70, "channel": 1, "max_us": 2300},
        "leg1_coxa": {"channel": 3},
    }
    servo_map = load_servo_map(edited_file(tmp_path, put("servos", section)))
    assert servo_map.channels[:3].tolist() == [3, 2, 1]
    assert servo_map.offsets_deg[:6].tolist() == [0, 0, 70, 0, 0, 75]
    assert servo_map.signs[:3].tolist() == [1, 1, -1]
    assert servo_map.max_us[:3].tolist() == [2500, 2500, 2300]
    assert (servo_map.us_per_deg, servo_map.centre_us, servo_map.low_battery_v) == (10, 1520, 9.9)


def test_it_changes_neither_the_robot_nor_its_fingerprint(tmp_path: Path) -> None:
    path = edited_file(tmp_path, put("servos", {"leg1_coxa": {"sign": -1, "offset_deg": 12}}))
    assert load_robot(path).fingerprint == shipped().fingerprint


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"leg7_coxa": {}}, "unknown key servos.leg7_coxa; allowed here: .*leg6_tibia"),
        ({"leg1_coxa": {"chanel": 1}}, "unknown key servos.leg1_coxa.chanel; allowed here: channel"),
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
        load_servo_map(path)
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


def test_ranges_wider_than_the_pulses_are_named(tmp_path: Path) -> None:
    robot = shipped()
    path = edited_file(tmp_path, put("servos", {"tibia": {"offset_deg": 75}}))
    assert joints_beyond_pulses(load_servo_map(path), robot) == ()
    path = edited_file(
        tmp_path, put("servos", {"leg2_femur": {"offset_deg": 1}, "tibia": {"offset_deg": 75}})
    )
    assert joints_beyond_pulses(load_servo_map(path), robot) == ("leg2_femur",)
    assert len(JOINT_NAMES) == N_JOINTS


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


ANT = config_root() / "robots" / "ant.yaml"
SHIPPED = "".join(
    line
    for line in ANT.read_text(encoding="utf-8").splitlines(keepends=True)
    if not line.startswith("servos")
)

SECTIONS = {
    "none": SHIPPED,
    "no newline at the end": SHIPPED.rstrip("\n"),
    "flow": SHIPPED + "servos: {tibia: {offset_deg: 75}} # mine\n",
    "flow over lines": SHIPPED + "servos: {tibia: {offset_deg: 75},\n  coxa: {sign: -1}\n}\n",
    "block in the middle": SHIPPED.replace(
        "foot_radius_m:",
        "servos:\n  # the tibias\n  tibia:\n    offset_deg: 75 # horn\n\n# about the feet\nfoot_radius_m:",
    ),
    "block at the end": SHIPPED + "servos:\n  tibia: {offset_deg: 75}\n\n# the end\n",
    "empty": SHIPPED + "servos: {}\n",
}


@pytest.mark.parametrize("kind", SECTIONS)
def test_only_the_section_changes(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(SECTIONS[kind], encoding="utf-8")
    wanted = default_servo_map()
    write_servo_map(path, wanted)
    assert load_servo_map(path) == wanted
    assert load_robot(path).fingerprint == shipped().fingerprint
    kept = [line for line in SHIPPED.splitlines() if line]
    written = path.read_text(encoding="utf-8").splitlines()
    assert [line for line in written if line in kept] == kept
    for comment in ("# about the feet", "# the end"):
        assert (comment in written) == (comment in SECTIONS[kind].splitlines())
    assert list(tmp_path.iterdir()) == [path]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
@given(servo_maps())
def test_what_is_written_is_read_back_to_the_last_bit(tmp_path: Path, servo_map: ServoMap) -> None:
    whole = ServoMap(**{**vars(servo_map), "centre_us": float(round(servo_map.centre_us))})
    path = tmp_path / "mine.yaml"
    path.write_text(SHIPPED, encoding="utf-8")
    write_servo_map(path, whole)
    write_servo_map(path, whole)
    assert load_servo_map(path) == whole


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


def test_shipped_files_are_refused_with_how_to_copy_them() -> None:
    with pytest.raises(InputError, match=r"shipped robot ant; allowed: .*cp .*ant\.yaml my-ant\.yaml"):
        check_writable(ANT)


def test_a_file_that_is_a_link_keeps_being_one(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    real, link = tmp_path / "there" / "real.yaml", tmp_path / "link.yaml"
    real.write_text(SHIPPED, encoding="utf-8")
    link.symlink_to(real)
    write_servo_map(link, default_servo_map())
    assert link.is_symlink()
    assert "servos:" in real.read_text(encoding="utf-8")


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
