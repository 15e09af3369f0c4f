"""The programs and files that README and docs show do what the text says."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hexctl.backends.sim.world import DomainRandomization, World
from hexctl.cli.main import exit_code
from hexctl.control.assessment.speed_envelope import VelocityLimits
from hexctl.gait.gait import DEFAULT_GAIT, make_gait
from hexctl.robot.formats.link_frames import BASE_LINK
from hexctl.robot.loader import load_meshes, load_robot, load_robot_file
from hexctl.robot.schema import MountSection, RobotSchema
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.robot.servos.pwm_map import pwm_map_of
from hexctl.types import JOINT_NAMES
from hexctl.wire.certificates import make_certificates
from hexctl.wire.links import load_link
from tests.docs.pages import PAGES, ROOT, blocks, save_programs
from tests.robot.meshmaking import MAKERS
from tests.robots import edited_file, put
from tests.vision.scenes import film_walk


def a_link(values: dict[str, Any], folder: Path) -> None:
    make_certificates(folder / "keys", hosts=["robot.local"], days=2)
    (folder / "link.yaml").write_text(yaml.safe_dump({**values, "plain": False}))
    load_link(str(folder / "link.yaml"))


def servos(values: dict[str, Any], _folder: Path) -> None:
    robot = yaml.safe_load((ROOT / "configs" / "robots" / "ant.yaml").read_text())
    RobotSchema.model_validate({**robot, **values})


def parts(values: Any, _folder: Path) -> None:
    """Mounts by themselves, or sections that replace those of a whole robot."""
    if isinstance(values, list):
        for value in values:
            MountSection.model_validate(value)
        return
    robot = yaml.safe_load((ROOT / "configs" / "robots" / "phantomx.yaml").read_text())
    RobotSchema.model_validate({**robot, **values, "joints": robot["joints"] | values.get("joints", {})})


def meshes(values: dict[str, Any], folder: Path) -> None:
    (folder / "looks").mkdir()
    for part in values["meshes"].values():
        (folder / part["file"]).write_bytes(MAKERS[f"box{Path(part['file']).suffix}"]())
    assert set(load_meshes(edited_file(folder, put("meshes", values["meshes"])))) == set(values["meshes"])


def worlds(values: dict[str, Any], _folder: Path) -> None:
    """A world, or a family of them."""
    (DomainRandomization if "ranges" in values else World).model_validate(values)


def driven_servos(content: dict[str, Any], folder: Path) -> object:
    """Servos on a bus, or on a board that makes pulses."""
    driver = content["servos"]["driver"]
    file = load_robot_file(edited_file(folder, put("servos", content["servos"])))
    map_of = pwm_map_of if driver in ("servo2040", "pca9685") else bus_map_of
    return map_of(file.content.servos, driver)


def ros_parameters(content: dict[str, Any], _folder: Path) -> None:
    """Parameters of ros2_control, whose controller has the robot's joints, or of Nav2."""
    nodes = {node: values["ros__parameters"] for node, values in content.items()}
    if "controller_manager" in nodes:
        assert nodes["joint_trajectory_controller"]["joints"] == list(JOINT_NAMES)
        return
    assert {nodes[node]["base_frame_id"] for node in ("amcl", "collision_monitor")} == {BASE_LINK}
    robot = load_robot("ant")
    limits = VelocityLimits.of(robot, make_gait(robot, DEFAULT_GAIT))
    pace = nodes["controller_server"]["FollowPath"]
    for greatest in ([pace["vx_max"], 0, 0], [0, pace["vy_max"], 0], [0, 0, pace["wz_max"]]):
        assert limits.limited(np.array(greatest)).tolist() == greatest
    smoother = nodes["velocity_smoother"]
    assert smoother["max_velocity"] == [pace["vx_max"], pace["vy_max"], pace["wz_max"]]
    assert smoother["min_velocity"] == [-limit for limit in smoother["max_velocity"]]
    assert nodes["behavior_server"]["max_rotational_vel"] == pace["wz_max"]


#: Readers of YAML, by a key or a driver that only their files have; all else are parts of a robot file.
READERS: dict[str, Callable[[Any, Path], object]] = {
    "friction": worlds,
    "ranges": worlds,
    "meshes": meshes,
    "endpoint": a_link,
    "amcl": ros_parameters,
    "controller_manager": ros_parameters,
    **dict.fromkeys(("servo2040", "pca9685", "dynamixel", "feetech", "lx16a"), driven_servos),
    "servos": servos,
}


def reader_of(content: Any) -> Callable[[Any, Path], object]:
    names = {*content} | {content["servos"].get("driver")} if "servos" in content else {*map(str, content)}
    return next((reader for name, reader in READERS.items() if name in names), parts)


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "yaml")], ids=lambda page: page.name)
def test_the_files_of_a_page_are_accepted(page: Path, tmp_path: Path) -> None:
    for block in blocks(page, "yaml"):
        content = yaml.safe_load(block.text)
        reader_of(content)(content, tmp_path)


#: What the programs of a page need: a command of hexctl that makes it.
NEEDED = {
    "recordings.md": [
        *("adapt", "--failed-leg", "5", "--optimizer", "random", "--budget", "2", "--duration", "1"),
        *("--no-record", "--json"),
    ],
}


#: What the programs of a page need besides: a file that no command makes.
MADE: dict[str, Callable[[Path], None]] = {"camera.md": film_walk}

#: What the README's program prints, and how many lines it has at most.
README = (r"\(18,\)\n", 12)


@pytest.mark.long
@pytest.mark.parametrize(
    "page", [page for page in PAGES if blocks(page, "python")], ids=lambda page: page.name
)
def test_the_programs_of_a_page_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert page.name not in NEEDED or exit_code(NEEDED[page.name]) == 0
    if page.name in MADE:
        MADE[page.name](tmp_path)
    save_programs(page, tmp_path)
    for block in blocks(page, "python"):
        (tmp_path / "block.py").write_text(block.text)  # a file: docstrings of options are read from source
        done = subprocess.run(
            [sys.executable, "block.py"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        if page.name == "README.md":
            answer, most_lines = README
            assert re.fullmatch(answer, done.stdout)
            assert len(block.lines) <= most_lines
