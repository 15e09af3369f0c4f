"""What README and docs tell a user to type works as it stands."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from hexctl.backends.sim.world import World
from hexctl.cli.main import app, exit_code

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def hexctl_lines() -> list[str]:
    """Return the commands of all pages but those whose files a test of their own makes."""
    pages = [page for page in PAGES if page.name not in ("own-servos.md", "real-robot.md")]
    lines = [line for page in pages for block in blocks(page, "sh") for line in block.splitlines()]
    return [line.split("#")[0].strip() for line in lines if line.startswith("hexctl ")]


def shortened(arguments: list[str]) -> list[str]:
    """Return a command that shows the same in less time and opens no window."""
    arguments = [argument for argument in arguments if argument not in ("--view", "--realtime")]
    less = {"run": ["--duration", "1"], "adapt": ["--budget", "3"]}
    return [*arguments, *less.get(arguments[0], [])]


@pytest.mark.parametrize("line", [line for line in hexctl_lines() if not line.startswith("hexctl view")])
def test_commands(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert exit_code(shortened(shlex.split(line)[1:])) == 0


def test_the_readme_names_many_commands() -> None:
    assert len(hexctl_lines()) >= 8


def test_the_python_program_of_the_readme(tmp_path: Path) -> None:
    (program,) = blocks(ROOT / "README.md", "python")
    assert len([line for line in program.splitlines() if line]) <= 12
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"ok: \d\.\d\d m, 0\.\d{3} m off the line\n", done.stdout)


def test_the_world_file_of_the_readme() -> None:
    (text,) = blocks(ROOT / "README.md", "yaml")
    World.model_validate(yaml.safe_load(text))


def test_the_servos_of_the_docs(tmp_path: Path) -> None:
    page = ROOT / "docs" / "own-servos.md"
    (program,) = blocks(page, "python")
    (tmp_path / "mykit.py").write_text(program)
    (tmp_path / "mykit.yaml").write_text((ROOT / "configs" / "robots" / "phantomx.yaml").read_text())
    commands = [line for block in blocks(page, "sh") for line in block.splitlines()]
    for command in commands:
        arguments = shlex.split(command)
        arguments = arguments[3:] if arguments[0] == "python" else arguments[1:]
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "hexctl",
                *[{"5": "0.2"}.get(argument, argument) for argument in arguments],
            ],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert "://" in target or (page.parent / target).exists(), target


def test_the_commands_of_the_real_robots_page_with_a_kit_in_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "real-robot.md"
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    assert lines[0].startswith("cp configs/robots/")
    source, target = lines[0].split()[1:]
    (tmp_path / target).write_bytes((ROOT / source).read_bytes())
    for line in lines[1:]:
        assert exit_code(shortened(shlex.split(line)[1:])) == 0


def test_every_command_of_the_pages_exists_with_its_options() -> None:
    """The commands that need hardware, certificates or minutes: at least they are what hexctl takes."""
    lines = [line for page in PAGES for block in blocks(page, "text") for line in block.splitlines()]
    commands = [shlex.split(line, comments=True) for line in lines if line.startswith("hexctl ")]
    assert len(commands) >= 10
    for command in commands:
        assert_options_exist([word for word in command[1:] if word != "\u2026"])


def assert_options_exist(arguments: list[str]) -> None:
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands") and arguments:
        command = command.commands[arguments.pop(0)]
    known = {name for parameter in command.params for name in parameter.opts}
    for argument in arguments:
        assert not argument.startswith("--") or argument in known, f"{argument} of {command.name}"
