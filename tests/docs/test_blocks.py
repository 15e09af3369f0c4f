"""The programs and files that README and docs show do what the text says."""

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
import yaml

from hexctl.backends.base import LegServos
from hexctl.backends.bus.bus_map import bus_map_of
from hexctl.backends.pwm.pulse_board import pwm_map_of
from hexctl.backends.registry import BackendOptions, check_options, make_servos
from hexctl.backends.sim.world import DomainRandomization, World
from hexctl.cli.main import app, exit_code
from hexctl.control.planning.speed_envelope import VelocityLimits
from hexctl.errors import InputError
from hexctl.gait.gait import DEFAULT_GAIT, make_gait
from hexctl.robot.formats.link_frames import BASE_LINK
from hexctl.robot.loader import load_meshes, load_robot, load_robot_file
from hexctl.robot.schema import MountSection, RobotSchema
from hexctl.robot.servos.drivers import BOARDS, FAMILIES, is_board
from hexctl.testing import LegServosConformance
from hexctl.types import JOINT_NAMES
from hexctl.wire.certificates import make_certificates
from hexctl.wire.links import load_link
from tests.backends.fake_time import FakeTime
from tests.docs.pages import LANGUAGES, PAGES, ROOT, blocks, commands, inline_commands, save_programs, tabs
from tests.docs.shell import Shell, of_hexctl, parse
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
    map_of = pwm_map_of if is_board(driver) else bus_map_of
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
    **dict.fromkeys((*FAMILIES, *BOARDS), driven_servos),
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


@pytest.mark.long
@pytest.mark.parametrize(
    "page", [page for page in PAGES if blocks(page, "python")], ids=lambda page: page.name
)
def test_the_programs_of_a_page_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if page.name == "recordings.md":  # its programs read a session
        adapt = "adapt --failed-leg 5 --optimizer random --budget 2 --duration 1 --no-record --json"
        assert exit_code(adapt.split()) == 0
    if page.name == "camera.md":
        film_walk(tmp_path)
    save_programs(page, tmp_path)
    for block in blocks(page, "python"):
        (tmp_path / "block.py").write_text(block.text)  # a file: docstrings of options are read from source
        done = subprocess.run(
            [sys.executable, "block.py"], capture_output=True, text=True, timeout=120, check=False
        )
        assert done.returncode == 0, done.stderr
        if page.name == "README.md":
            assert re.fullmatch(r"\(18,\)\n", done.stdout)
            assert len(block.lines) <= 12


KIT = "mykit:KitServos"


@pytest.fixture(scope="module")
def kit_in_this_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Save `mykit.py` of the page in a folder of the path."""
    folder = tmp_path_factory.mktemp("kit")
    save_programs(ROOT / "docs" / "how-to" / "extend.md", folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield
    sys.modules.pop("mykit", None)


def kit_options(**given: object) -> BackendOptions:
    file = load_robot_file("ant")
    return BackendOptions(robot=file.robot, robot_file=file, **given)  # type: ignore[arg-type]


@pytest.mark.usefixtures("kit_in_this_folder")
class TestKitServos(LegServosConformance):
    def make(self) -> LegServos:
        servos = make_servos(KIT, kit_options())
        vars(servos)["_clock"] = FakeTime().clock()  # its own one waits
        return servos


@pytest.mark.usefixtures("kit_in_this_folder")
def test_the_section_servos_and_the_port_reach_the_kit(tmp_path: Path) -> None:
    port = tmp_path / "port"
    check_options(KIT, port=str(port))
    with make_servos(KIT, kit_options(port=str(port))) as servos:
        state = servos.read()
        assert not state.measured
    assert port.read_text() == ""
    with pytest.raises(InputError, match=f"^seed: got 3 with backend {KIT}, whose class takes no `seed`"):
        check_options(KIT, seed=3)


#: The beginning of a line that somebody would type.
COMMAND = re.compile(r"\s*(\$ |# )?(hexctl|make|pip|python3?|git|sudo|mkdocs|dask)\s")


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.parametrize(
    ("page", "tab"),
    [
        pytest.param(page, tab, id="-".join(filter(None, (page.name, tab))))
        for page in PAGES
        if commands(page)
        for tab in tabs(page)
    ],
)
def test_the_commands_of_a_page(
    page: Path, tab: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page with tabs is followed once in each of them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    # For the programs it starts: no display, one thread.
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    save_programs(page, tmp_path)
    with Shell(tmp_path, page) as shell:
        for words in commands(page, tab):
            shell.do(words)


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)], ids=lambda page: page.name)
def test_each_command_is_one_that_hexctl_takes(page: Path) -> None:
    """Run are those of some pages by `.ci/run` and of all by `make test-all`."""
    for words in commands(page):
        for arguments in of_hexctl(words):
            parse(arguments)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_command_escapes(page: Path) -> None:
    """Commands stand in `sh` blocks, where they are run."""
    for block in blocks(page):
        assert block.language in LANGUAGES, f"a block of {block.language!r}"
        if block.language != "sh":
            assert not [line for line in block.lines if COMMAND.match(line)], block.language


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_the_text_exist_with_their_options(page: Path) -> None:
    for words in inline_commands(page, "hexctl"):
        assert_exists(words[1:])
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for words in inline_commands(page, "make"):
        for target in (word for word in words[1:] if "=" not in word):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"make {target}"


def assert_exists(words: list[str]) -> None:
    """Check a command that may have placeholders: SESSION, FILE or three dots."""
    command = typer.main.get_command(app)
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        command = command.commands[words[0]]
        words = words[1:]
    known = {name for parameter in command.params for name in getattr(parameter, "opts", ())}
    known |= {"--help", "--version"}
    for word in words:
        assert not word.startswith("--") or word in known, f"{word} of {command.name}"
