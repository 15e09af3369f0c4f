"""What a calibration writes into a robot file: one joint, and no other key or comment."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.robot.configs import config_root, read_mapping
from hexctl.robot.loader import load_robot, load_robot_file
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.robot.servos.raw_map import RawMap
from hexctl.robot.servos.servo_map import ServoMap, default_servo_map
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.robot.servos.servos_section import back_up, check_writable, write_joint
from hexctl.types import JOINT_KINDS, JOINT_NAMES
from tests.robot.test_servo_maps import servo_maps
from tests.robots import shipped

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


numbers = st.floats(-90, 90).map(lambda value: round(value, 3))

keys = {
    "sign": st.sampled_from([1, -1]),
    "offset_deg": numbers,
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
