"""A servo map written into a robot file: only its section changes, and nothing older is lost."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from hexctl.errors import InputError
from hexctl.robot.configs import config_root
from hexctl.robot.file import load_robot
from hexctl.robot.servofile import back_up, check_writable, write_servo_map
from hexctl.robot.servomap import ServoMap, default_servo_map, load_servo_map
from tests.robot.test_servomap import servo_maps
from tests.robots import shipped

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


def same(one: ServoMap, other: ServoMap) -> bool:
    return all(
        np.array_equal(np.asarray(getattr(one, name)), np.asarray(getattr(other, name))) for name in vars(one)
    )


@pytest.mark.parametrize("kind", SECTIONS)
def test_only_the_section_changes(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(SECTIONS[kind], encoding="utf-8")
    wanted = default_servo_map()
    write_servo_map(path, wanted)
    assert same(load_servo_map(path), wanted)
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
    assert same(load_servo_map(path), whole)


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
