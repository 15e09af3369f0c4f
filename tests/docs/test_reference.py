"""The generated references name every option and field, and the examples in docstrings run."""

import importlib
import inspect
import sys
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import Any

import pytest
from pydantic import BaseModel

import hexctl
from hexctl.adapt.adaptation import adapt
from hexctl.backends.bus.families.registers import FactoryValue, Register, RegisterTable, RequiredValue
from hexctl.backends.registry import BACKENDS
from hexctl.backends.sim.world import DomainRandomization, World
from hexctl.control.trial_result import TrialResult
from hexctl.robot.schema import RobotSchema
from hexctl.robot.sensors import failures_shown
from tests.cli.test_options import commands
from tests.docs.pages import ROOT
from tests.robots import shipped

sys.path.append(str(ROOT / "docs"))

#: The site imports it from there, too.
generated_reference: Any = importlib.import_module("generated_reference")


def test_every_option_of_every_command_is_on_the_page() -> None:
    page = generated_reference.command_reference()
    sections = {part.splitlines()[0]: part for part in page.split("### ")[1:]}
    for path, command in commands():
        for parameter in command.params:
            if parameter.name in ("help", "help_all"):
                continue
            is_option = parameter.param_type_name == "option"
            typed = parameter.opts if is_option else [parameter.metavar or parameter.name.upper()]
            for flag in typed:
                assert flag.replace("|", "\\|") in sections[path], f"{path} {flag}"


def schemas_in(kind: Any, seen: set[Any]) -> Iterator[Any]:
    """A schema and all schemas below it."""
    for found in generated_reference._schemas(kind):
        if found not in seen:
            seen.add(found)
            yield found
            for below, *_ in generated_reference._keys(found).values():
                yield from schemas_in(below, seen)


@pytest.mark.parametrize(
    ("make", "roots"),
    [
        (generated_reference.robot_reference, [RobotSchema]),
        (generated_reference.world_reference, [World, DomainRandomization]),
    ],
)
def test_every_key_of_a_file_is_on_the_page(make: Callable[[], str], roots: list[type[BaseModel]]) -> None:
    page = make()
    for root in roots:
        for schema in schemas_in(root, set()):
            for name in generated_reference._keys(schema):
                assert f"`{name}`" in page, f"{schema.__name__}.{name}"


def test_every_key_of_a_robot_file_has_a_meaning() -> None:
    """None is of a key that does not exist."""
    for schema in schemas_in(RobotSchema, set()):
        name, keys = schema.__name__, generated_reference._keys(schema).keys()
        assert generated_reference._attributes(schema).keys() <= keys
        if name not in ("LinksSection", "JointsSection", "MeshesSection"):  # their keys are parts of a leg
            missing = keys - generated_reference.meanings(schema).keys()
            assert not {key for key in missing if key not in ("femur", "tibia") and key[:3] != "leg"}, name


def test_every_register_is_on_the_page() -> None:
    page = generated_reference.register_reference()
    for kind in (RegisterTable, Register, RequiredValue, FactoryValue):
        assert f"### {kind.__name__}" in page
        assert [field.name for field in fields(kind) if f"| `{field.name}` |" not in page] == []
    assert "1 while the servo holds its goal" in page


def test_every_key_of_a_result_is_on_the_page() -> None:
    done = hexctl.run(duration_s=0.2, record=False)
    page = generated_reference.result_reference()
    assert done.outcome.keys() == generated_reference.outcome_keys().keys() | done.trial.to_dict().keys()
    for name in (*done.outcome, *(field.name for field in fields(TrialResult))):
        assert f"`{name}`" in page, name


def test_bounds_are_words() -> None:
    keys = generated_reference._keys(World)
    allowed = {name: generated_reference.allowed(kind, marks) for name, (kind, marks, _) in keys.items()}
    assert allowed["friction"] == "above 0 to 5"
    assert allowed["payload_position_m"] == "3 times: -1 to 1"
    assert allowed["friction_cone"] == "elliptic, pyramidal"


#: Names that most programs use.
WITH_EXAMPLE = (
    hexctl.Drive,
    hexctl.run,
    adapt,
    hexctl.load_robot,
    hexctl.load_world,
    hexctl.make_gait,
    hexctl.Controller,
    hexctl.Objective,
    hexctl.Optimizer,
    hexctl.joint_angles_of_feet,
    hexctl.read_trial,
    hexctl.run_sim_trials,
)


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_EXAMPLE, ids=lambda name: name.__name__)
def test_the_example_of_a_docstring_runs(name: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = inspect.cleandoc(name.__doc__)
    paragraphs = text.split("\n\n")
    first = next(index for index, part in enumerate(paragraphs) if part.startswith("    "))
    last = next(
        (index for index, part in enumerate(paragraphs) if index > first and not part.startswith("    ")),
        len(paragraphs),
    )
    example = textwrap.dedent("\n\n".join(paragraphs[first:last]))
    scope = {"hexctl": hexctl, "Drive": hexctl.Drive, "robot": hexctl.load_robot("ant")}
    exec(example, scope)  # noqa: S102  our own docstring


def test_the_status_of_every_driver_and_kit_is_on_its_page() -> None:
    page = (ROOT / "docs" / "results" / "hardware.md").read_text(encoding="utf-8")
    rows = {line.split("`")[1] for line in page.splitlines() if line.startswith("| `")}
    drivers = BACKENDS.keys() - {"sim", "mock", "zenoh"} | {"hiwonder"}  # the last one is an example
    kits = {path.stem for path in (ROOT / "configs" / "robots").glob("*.yaml")} - {"ant", "pexod"}
    assert rows == drivers | kits


def test_the_readme_says_of_each_kit_what_its_sensors_show() -> None:
    head = "| kit | robot file | servos | detects failures of |"
    table = (ROOT / "README.md").read_text(encoding="utf-8").split(head)[1].split("\n\n")[0]
    lines = [line for line in table.splitlines() if "`" in line]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    rows = [row for row in rows if "[" not in row[1]]  # a robot of one's own
    assert len(rows) >= 5
    for _, robots, _, shown in rows:
        for name in robots.replace("`", "").split(", "):
            assert failures_shown(shipped(name).sensors) == shown
