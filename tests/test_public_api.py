"""The public names: all there, described, imported when first used; and they refuse wrong types by name."""

import ast
import inspect
import os
import re
import subprocess
import sys
import typing
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import hexctl
import hexctl.extension
import hexctl.vision
from hexctl.backends.mock import MockServos
from hexctl.control.log import TickLog
from hexctl.errors import WrongTypeError
from hexctl.mujoco_import import import_undrawn
from hexctl.server.service import serve

ROOT = Path(__file__).parents[1]


def python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    return done.stdout.strip()


#: Packages with public names.
PUBLIC: tuple[Any, ...] = (hexctl, hexctl.extension, hexctl.vision)


def undescribed(package: Any, name: str) -> Iterator[str]:
    """A public name and the attributes of a public class that have no docstring."""
    found = getattr(package, name)
    if not inspect.getdoc(found):
        yield name
    for attribute, value in vars(found).items() if inspect.isclass(found) else ():
        function = getattr(value, "fget", value) or value
        public = not attribute.startswith("_") and inspect.isfunction(function)
        if public and not inspect.getdoc(getattr(found, attribute)):
            yield f"{name}.{attribute}"


@pytest.mark.parametrize("package", PUBLIC, ids=lambda package: str(package.__name__))
def test_the_public_names_are_there_and_described(package: Any) -> None:
    assert [each for name in package.__all__ for each in undescribed(package, name)] == []
    assert set(package.__all__) <= set(dir(package))


@pytest.mark.parametrize("package", PUBLIC, ids=lambda package: str(package.__name__))
def test_the_names_for_type_checkers_are_those_that_are_imported(package: Any) -> None:
    (block,) = [
        node for node in ast.parse(Path(package.__file__).read_text()).body if isinstance(node, ast.If)
    ]
    imported = {alias.name for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert imported == set(package.__all__)
    assert len(package.__all__) == len(imported)


def test_an_import_loads_nothing_heavy() -> None:
    loaded = python("import hexctl, hexctl.vision, sys; print(*sys.modules)").split()
    assert not {"numpy", "mujoco", "rerun", "typer", "pydantic", "zenoh", "pytest", "cv2"} & set(loaded)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "name", "extra"), [("dm_control", "SimServos", "sim"), ("cv2", "vision.RobotCamera", "see")]
)
def test_a_missing_extra_is_named(module: str, name: str, extra: str) -> None:
    code = f"import sys; sys.modules[{module!r}] = None\nimport hexctl, hexctl.vision\ntry: hexctl.{name}\n"
    said = python(f"{code}except ImportError as error: print(error)")
    assert said.startswith(f'hexctl.{name} needs the "{extra}" extra: ')
    assert f"[{extra}]" in said


def test_an_unknown_name_is_answered_with_the_known_ones() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Robott'; it has Robot, load_robot"):
        _ = api.Robott
    with pytest.raises(
        AttributeError, match=r"'hexctl.vision' has no attribute 'Camara'; it has RobotCamera"
    ):
        _ = api.vision.Camara


@pytest.mark.parametrize("name", ["adapt", "export"])
def test_a_package_that_is_called_is_its_function(name: str) -> None:
    package = getattr(hexctl, name)
    assert inspect.ismodule(package)
    assert callable(package)
    parameters = inspect.signature(package).parameters
    assert {"adapt": "failed_leg", "export": "to"}[name] in parameters
    with pytest.raises((TypeError, hexctl.InputError)):
        package(no_such_argument=1)


def test_annotations_resolve() -> None:
    for name in hexctl.__all__:
        found = getattr(hexctl, name)
        if inspect.isfunction(found) and found.__module__ != "hexctl.runs.run":
            typing.get_type_hints(found)


ROBOT = hexctl.load_robot("ant")
GAIT = hexctl.make_gait(ROBOT, "tripod")
PLAN = hexctl.TrialPlan(gait=GAIT, duration_s=0.1, settle_s=0.1)

#: The names without their types, for what a type checker would refuse as well.
api: Any = hexctl

#: What is called with a value of a wrong type, by the argument that its answer names.
WRONG: tuple[tuple[str, Callable[[], Any]], ...] = (
    ("gait", lambda: api.TrialPlan(gait="tripod")),
    ("robot", lambda: api.SimServos(5)),
    ("world", lambda: api.SimServos("ant", world=5)),
    ("failures", lambda: api.SimServos("ant", failures=5)),
    ("servos", lambda: api.Guard("ant")),
    ("servos", lambda: api.run_trial("ant", PLAN)),
    ("plan", lambda: api.run_trial(MockServos("ant"), GAIT)),
    ("controller", lambda: api.run_trial(MockServos("ant"), PLAN, 5)),
    ("recorders", lambda: api.run_trial(MockServos("ant"), PLAN, None, [5])),
    ("recorders", lambda: api.run_trial(MockServos("ant"), PLAN, None, TickLog())),
    ("robot", lambda: api.SimTrial(robot=5, plan=PLAN, failures=None)),
    ("trial.plan", lambda: api.SimTrial(robot=ROBOT, plan=GAIT, failures=None)),
    ("trials", lambda: api.run_sim_trials([PLAN])),
    ("failed legs", lambda: api.GaitSpace(5)),
    ("optimizer", lambda: api.make_optimizer(5, api.GaitSpace((5,)), 0)),
    ("space", lambda: api.make_optimizer("pso", 5, 0)),
    ("world", lambda: api.load_world(7)),
    ("robot", lambda: api.load_robot(7)),
    ("make_gait: robot", lambda: api.make_gait("ant", "tripod")),
    ("failed_leg", lambda: api.adapt(failed_leg=5.5)),
    ("robot", lambda: api.adapt(failed_leg=5, robot=ROBOT)),
    ("spec", lambda: api.Adaptation(5)),
    ("run", lambda: api.run("ant")),
    ("failure", lambda: api.run(failure=5)),
)


def test_a_wrong_type_is_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, call in WRONG:
        with pytest.raises(WrongTypeError, match=f"^{re.escape(name)}: ") as caught:
            call()
        assert isinstance(caught.value, TypeError)
    assert not list(tmp_path.iterdir())


def test_what_is_unambiguous_is_accepted() -> None:
    trial = hexctl.SimTrial(robot="ant", world="slippery", plan=PLAN, failures=None)
    assert trial.robot == ROBOT
    assert trial.world == hexctl.load_world("slippery")
    assert replace(trial, seed=3).world == trial.world
    slope = hexctl.SimServos(ROOT / "configs/robots/ant.yaml", world=ROOT / "configs/worlds/slope.yaml")
    assert slope.world == hexctl.load_world("slope")
    assert api.GaitSpace([2, 5]) == hexctl.GaitSpace((2, 5))
    with pytest.raises(hexctl.InputError, match=r"serve: got device; .* did you mean 'device_keys'"):
        serve(device=5)


def test_a_simulation_without_a_guard_gets_one() -> None:
    with hexctl.SimServos("ant") as servos:
        alone = hexctl.run_trial(servos, PLAN, soft_stop=False)
    with hexctl.SimServos("ant") as servos:
        guarded = hexctl.run_trial(hexctl.Guard(servos), PLAN, soft_stop=False)
    assert alone == guarded


def test_a_broken_graphics_library_stops_no_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = "import os\nif os.environ['MUJOCO_GL'] != 'disable':\n    raise AttributeError('glGetError')\n"
    (tmp_path / "draws.py").write_text(broken)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert import_undrawn("draws").__name__ == "draws"
    assert os.environ["MUJOCO_GL"] == "osmesa"
