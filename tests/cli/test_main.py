"""The program itself: help, version, what it needs and what it says when that is missing."""

import subprocess
import sys

import pytest

HEAVY = ("mujoco", "dm_control", "rerun", "numpy", "pydantic", "yaml", "scipy")


def python(code: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )


def test_help_loads_nothing_heavy() -> None:
    done = python(
        "import sys\nfrom hexctl.cli.main import exit_code\n"
        "assert exit_code(['--help']) == 0\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    assert done.returncode == 0
    assert "run" in done.stdout
    assert done.stderr.strip() == "[]"


def test_importing_hexctl_loads_nothing() -> None:
    done = python(f"import sys, hexctl\nprint([name for name in {HEAVY!r} if name in sys.modules])")
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("blocked", "arguments", "extra"),
    [
        ("dm_control", ["run", "--no-record"], 'pip install "hexctl[sim]"'),
        ("mujoco", ["run", "--no-record"], 'pip install "hexctl[sim]"'),
        ("rerun", ["run"], 'pip install "hexctl[view]"'),
        ("mujoco", ["study"], 'pip install "hexctl[sim]"'),
        ("mujoco", ["study", "--transfer"], 'pip install "hexctl[sim]"'),
        ("mujoco", ["prior", "build"], 'pip install "hexctl[sim]"'),
        ("pyarrow", ["study"], 'pip install "hexctl[study]"'),
    ],
)
def test_a_missing_extra_is_named(blocked: str, arguments: list[str], extra: str) -> None:
    done = python(
        f"import sys, os, tempfile\nos.chdir(tempfile.mkdtemp())\nsys.modules[{blocked!r}] = None\n"
        f"from hexctl.cli.main import exit_code\ncode = exit_code({arguments!r})\n"
        "assert os.listdir() in ([], ['runs']) and (not os.path.isdir('runs') or not os.listdir('runs'))\n"
        "sys.exit(code)"
    )
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert extra in done.stderr


def test_a_robots_computer_needs_no_extras() -> None:
    done = python(
        "import sys\nfor name in ('mujoco', 'dm_control', 'rerun', 'scipy'): sys.modules[name] = None\n"
        "from hexctl.cli.main import exit_code\n"
        "assert exit_code(['check', 'phantomx']) == 0\n"
        "sys.exit(exit_code(['run', '--backend', 'mock', '--no-record', '--duration', '0.1']))"
    )
    assert done.returncode == 0, done.stderr


def test_version() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hexctl", "--version"], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.startswith("hexctl 0.")
