"""Plug-ins: found by their metadata, imported when they are used, and refused with their distribution."""

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.main import get_command

from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.family import find_family
from hexctl.backends.bus.servos import BusServos
from hexctl.backends.pwm.pulse_board import find_board
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.backends.pwm.servo2040 import Servo2040Servos
from hexctl.backends.registry import BackendOptions, has_keeper, make_servos, raw_map_of
from hexctl.cli import completion
from hexctl.cli.commands import COMMANDS
from hexctl.cli.main import app
from hexctl.control.monitor.recovery import WalkOn, make_recovery
from hexctl.doctor.plugin_check import read_plugins
from hexctl.errors import InputError, MissingExtraError
from hexctl.robot.loader import load_robot, load_robot_file
from hexctl.robot.plugins import plugin_names, plugins
from hexctl.simulators.board_service import BoardService
from hexctl.simulators.bus_servos import simulated_servos
from tests.cli.conftest import Call
from tests.robots import edited_file, put, with_ids

Install = Callable[..., None]

MODULE = """
from hexctl.adapt.optimizers.baselines import RandomSearch
from hexctl.backends.mock import MockServos
from hexctl.control.monitor.recovery import WalkOn

class Search(RandomSearch):
    name = "outside"

class Servos(MockServos):
    pass

class Recovery(WalkOn):
    pass

def greet(name: str = "you") -> None:
    \"\"\"Greet.

    Args:
        name: somebody.
    \"\"\"
    print(f"hello {name}")
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Installs a distribution with entry points, as pip does, for one test."""
    monkeypatch.syspath_prepend(tmp_path)
    loaded = {*sys.modules}

    def installed(name: str = "outside", *, module: str = MODULE, **doors: str) -> None:
        """Each door's line of `entry_points.txt`; the module is named as the distribution."""
        info = tmp_path / f"{name}-1.2.dist-info"
        info.mkdir()
        (tmp_path / f"{name}.py").write_text(module)
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\nSummary: Words.\n"
        )
        lines = [f"[hexctl.{door}]\n{line}\n" for door, line in doors.items()]
        (info / "entry_points.txt").write_text("\n".join(lines))
        plugins.cache_clear()

    yield installed
    plugins.cache_clear()
    for found in {*sys.modules} - loaded:
        if found.startswith(("outside", "other")):
            del sys.modules[found]


FAMILY = """
from dataclasses import replace
from hexctl.backends.bus.families.feetech import FEETECH

FAMILY = replace(FEETECH, name="acme", simulated="outside:Nothing")
"""


def test_a_family_is_a_driver_and_a_backend_by_its_name(install: Install, tmp_path: Path) -> None:
    install(module=FAMILY, families="acme = outside:FAMILY\nother = outside:FAMILY\nno = outside:replace")
    assert completion.drivers("ac") == completion.backends("ac") == ["acme"]
    file = load_robot_file(
        edited_file(tmp_path, put("servos", with_ids({"driver": "acme", "port": "x"})), base="phantomx")
    )
    assert "outside" not in sys.modules, "a robot file imports no plug-in"
    bus_map = raw_map_of(file)
    assert isinstance(bus_map, BusMap)
    assert bus_map.family.name == "acme"
    made = make_servos("acme", BackendOptions(robot=file.robot, robot_file=file))
    assert isinstance(made, BusServos)
    with pytest.raises(InputError, match=r"outside:Nothing"):
        simulated_servos(bus_map)
    assert [one.name for one in read_plugins() if one.error] == ["no", "other"]
    for name in ("other", "no"):  # a family of another name, and a function
        with pytest.raises(InputError, match=rf"driver: {name} of outside 1\.2: "):
            find_family(name)


BOARD = """
from dataclasses import dataclass, replace
from hexctl.backends.pwm.servo2040 import SERVO2040

BOARD = replace(SERVO2040, name="acme", has_keeper=True)
"""


def test_a_board_of_a_plugin_is_a_driver_a_backend_and_a_simulated_board(
    install: Install, tmp_path: Path
) -> None:
    install(module=BOARD, boards="acme = outside:BOARD\nother = outside:BOARD\nno = outside:replace")
    assert completion.backends("ac") == ["acme"]
    file = load_robot_file(edited_file(tmp_path, put("servos", {"driver": "acme", "port": "/dev/ttyACM7"})))
    assert "outside" not in sys.modules, "a robot file imports no plug-in"
    pwm_map = raw_map_of(file)
    assert isinstance(pwm_map, PwmMap)
    assert pwm_map.driver == "acme"
    made = make_servos("acme", BackendOptions(robot=file.robot, robot_file=file))
    assert isinstance(made, Servo2040Servos)
    assert has_keeper("acme")
    report = BoardService(backend="mock", bus="acme").run(lambda: True)
    assert report["goals"] == 0
    assert [one.name for one in read_plugins() if one.error] == ["no", "other"]
    for name in ("other", "no"):
        with pytest.raises(InputError, match=rf"driver: {name} of outside 1\.2: "):
            find_board(name)


def test_each_door_takes_a_plugin_by_its_name(install: Install) -> None:
    install(
        servos="out = outside:Servos", optimizers="out = outside:Search", recoveries="on = outside:Recovery"
    )
    assert completion.optimizers("ou") == ["out"]
    assert completion.backends("ou") == ["out"]
    assert "outside" not in sys.modules, "the Tab key imports no plug-in"
    assert isinstance(make_optimizer("out", GaitSpace((5,)), 0), Optimizer)
    assert type(make_servos("out", BackendOptions(robot=load_robot("ant")))).__name__ == "Servos"
    assert isinstance(make_recovery("on"), WalkOn)
    found = [one for one in read_plugins() if one.distribution == "outside"]
    assert [(one.name, one.error) for one in found] == [("out", None), ("out", None), ("on", None)]


@pytest.mark.parametrize(
    ("module", "line", "error"),
    [
        ("import no_such_module_here\n", "out = outside:Search", InputError),
        ("1 / 0\n", "out = outside:Search", InputError),
        ("raise SystemExit\n", "out = outside:Search", InputError),
        (MODULE, "out = outside:Missing", InputError),
        (MODULE, "out = outside:Servos", InputError),
        (MODULE, "out = outside", InputError),
        ("raise ModuleNotFoundError(name='rerun')\n", "out = outside:Search", MissingExtraError),
    ],
)
def test_a_plugin_that_does_not_fit_is_refused_with_its_distribution(
    module: str, line: str, error: type[Exception], install: Install
) -> None:
    install(module=module, optimizers=line)
    with pytest.raises(error, match=r"outside 1\.2" if error is InputError else r"\[view\]"):
        make_optimizer("out", GaitSpace((5,)), 0)
    (found,) = [one for one in read_plugins() if one.name == "out"]
    assert found.error


def test_a_name_of_two_distributions_is_refused_with_both(install: Install) -> None:
    install("outside", optimizers="out = outside:Search")
    install("other", optimizers="out = other:Search")
    with pytest.raises(InputError, match=r"outside 1\.2.*|other 1\.2") as caught:
        make_optimizer("out", GaitSpace((5,)), 0)
    assert all(name in str(caught.value) for name in ("outside 1.2", "other 1.2", "optimizer"))
    assert all(one.error for one in read_plugins() if one.name == "out")


@pytest.mark.parametrize(
    ("door", "name", "used"),
    [
        ("optimizers", "random", lambda name: make_optimizer(name, GaitSpace((5,)), 0)),
        ("recoveries", "glide", make_recovery),
        ("servos", "sim", lambda name: make_servos(name, BackendOptions(robot=load_robot("ant")))),
        ("families", "feetech", find_family),
        ("boards", "servo2040", find_board),
        ("commands", "estop", lambda name: get_command(app).commands[name]),  # type: ignore[attr-defined]
    ],
)
def test_a_shipped_name_stays_hexctls(
    door: str, name: str, used: Callable[[str], object], install: Install
) -> None:
    install(**{door: f"{name} = outside:greet"})
    assert used(name)
    assert "outside" not in sys.modules
    assert [one.name for one in read_plugins(COMMANDS) if one.error] == [name]


def test_an_own_command_is_reported_if_its_module_is_missing(install: Install) -> None:
    install("hexctl", commands="sim = hexctl.simulators.sim_command:sim\nsee = hexctl.no_room.see:see")
    found = [one for one in read_plugins(COMMANDS) if one.distribution == "hexctl"]
    assert [one.name for one in found] == ["see"]
    assert "no_room" in str(found[0].error)


def test_a_command_of_a_plugin_is_listed_unimported_and_runs(install: Install, call: Call) -> None:
    install(commands="greet = outside:greet")
    assert "greet" in plugin_names("commands")
    listed = call("--help").out
    assert "greet" in listed
    assert "Words (outside:greet of outside 1.2)." in listed
    assert "outside" not in sys.modules
    assert "--name" in call("greet --help").out
    assert call("greet --name Ant").out == "hello Ant\n"


BROKEN = """
import typer
from hexctl.adapt.optimizer import Optimizer
from hexctl.backends.bus.families.lx16a import LX16A
from hexctl.backends.mock import MockServos
from hexctl.control.monitor.recovery import WalkOn

class NoName(Optimizer):
    def _suggest(self, count):
        return [1 // 0]
    def _learn(self, codes, scores):
        pass
    def _search_state(self):
        return {}
    def _restore_search(self, state):
        pass

class Suggests(NoName):
    name = "suggests"

class Asks(Suggests):
    def _suggest(self, count):
        return None

class Unstorable(Suggests):
    def _search_state(self):
        return {"seen": {1, 2}}

class Unmade(Suggests):
    def __init__(self, space, seed):
        {}["missing"]

class UnmadeRecovery(WalkOn):
    def __init__(self):
        {}["missing"]

class Unprepared(WalkOn):
    def prepare(self, robot, plan, heading_body_rad):
        {}["missing"]

class Unresponsive(WalkOn):
    def respond(self, robot, plan, heading_body_rad, failures):
        {}["missing"]

class UnmadeServos(MockServos):
    def __init__(self, robot):
        {}["missing"]

class Unconnected(MockServos):
    def connect(self):
        {}["missing"]

def greet():
    {}["missing"]

tools = typer.Typer(help="Tools for feet.")

@tools.command()
def wash():
    pass

@tools.command()
def dry():
    pass
"""

ADAPT = "adapt --failed-leg 5 --budget 1 --duration 2 --no-baseline --no-record --optimizer"


@pytest.mark.parametrize(
    ("door", "made", "line", "code"),
    [
        ("optimizers", "Unmade", f"{ADAPT} out", 2),
        ("optimizers", "NoName", f"{ADAPT} out", 2),
        ("optimizers", "Unstorable", f"{ADAPT} out", 2),
        ("optimizers", "Unmade", "study --optimizers out", 2),
        ("optimizers", "Suggests", f"{ADAPT} out", 3),
        ("optimizers", "Asks", f"{ADAPT} out", 3),
        ("recoveries", "UnmadeRecovery", "run --recovery out", 2),
        ("recoveries", "Unprepared", "run --recovery out --duration 1", 3),
        ("servos", "UnmadeServos", "run --backend out", 2),
        ("servos", "Unconnected", "run --backend out --duration 1", 3),
        ("families", "LX16A", "run --backend out", 2),
        ("families", "LX16A", "sim board --bus out", 2),
        ("boards", "LX16A", "run --backend out", 2),
        ("boards", "LX16A", "sim board --bus out", 2),
        ("commands", "greet", "out", 3),
    ],
)
def test_an_error_of_a_plugin_is_a_line_with_its_distribution_and_a_traceback_if_asked(
    door: str, made: str, line: str, code: int, install: Install, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(module=BROKEN, **{door: f"out = outside:{made}"})
    said = call(line, code=code).err.splitlines()[-1]
    assert said.startswith("hexctl: ")
    assert " of outside 1.2" in said
    words = line.split()
    if code == 2:  # as it was typed, not as another command names it
        assert f"{words[words.index('out') - 1]}: " in said
    monkeypatch.setenv("HEXCTL_DEBUG", "1")
    assert "Traceback (most recent call last)" in call(line, code=code).err


def test_a_recovery_that_fails_in_a_walk_is_named_with_its_distribution(
    install: Install, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(module=BROKEN, recoveries="out = outside:Unresponsive")
    line = "run --failure 2:limp@1 --recovery out --duration 3 --no-record"
    assert "outside:Unresponsive of outside 1.2" in call(line, code=4).out
    monkeypatch.setenv("HEXCTL_DEBUG", "1")
    assert "KeyError: 'missing'" in call(line, code=4).err


def test_a_group_keeps_its_help_and_lines_of_one_distribution_differ(install: Install, call: Call) -> None:
    install(module=BROKEN, commands="tools = outside:tools\ngreet = outside:greet")
    rows = [row.split("  ", 1)[1] for row in call("--help").out.splitlines() if "outside" in row]
    assert len({*rows}) == 2
    assert "outside" not in sys.modules
    assert "Tools for feet." in call("tools --help").out
    for line in ("tools --help-all", "tools wash --help-all", "greet --help-all", "doctor --help-all"):
        assert "--help" in call(line).out


def test_doctor_lists_plugins_line_by_line(install: Install, call: Call) -> None:
    install(
        module=BROKEN, commands="tools = outside:tools\nbad = outside:ADAPT", optimizers="z = outside:Asks"
    )
    lines = [line for line in call("doctor").out.splitlines() if "outside 1.2" in line]
    assert len(lines) == 3
    assert all(line.count("of outside 1.2") == 1 for line in lines)


def test_a_shadowed_name_is_offered_once(install: Install) -> None:
    install(optimizers="random = outside:Search", families="acme = outside:FAMILY")
    assert completion.optimizers("random") == ["random"]
    assert completion.buses("a") == ["acme"]


def test_a_command_that_is_no_function_is_refused(install: Install, call: Call) -> None:
    install(commands="greet = outside:MODULE_NAME", module="MODULE_NAME = 'outside'\n")
    assert "outside 1.2" in call("greet", code=2).refusal


def test_what_a_plugin_prints_at_import_is_no_output(install: Install, call: Call) -> None:
    install(
        module="print('noise')\n" + MODULE,
        commands="greet = outside:greet",
        optimizers="out = outside:Search",
    )
    assert json.loads(call("doctor --json").out)["plugins"]
    assert call("greet --name Ant").out == "hello Ant\n"


@pytest.mark.parametrize(
    "module", ["import no_such_module_here\n", "raise SystemExit\n", "class greet: pass\n"]
)
def test_a_broken_command_completes_to_nothing_and_doctor_names_it(
    module: str, install: Install, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(module=module, commands="greet = outside:greet")
    words = {"_HEXCTL_COMPLETE": "complete_bash", "COMP_WORDS": "hexctl greet ", "COMP_CWORD": "2"}
    for name, value in words.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit):
        app(prog_name="hexctl", args=[])
    assert "".join(capsys.readouterr()).strip() == ""
    assert [one.name for one in read_plugins(COMMANDS) if one.error] == ["greet"]
