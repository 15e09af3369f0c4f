"""Settings as defaults of options, in commands as a user calls them."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.core import TyperGroup

from hexctl.cli.main import app, exit_code
from hexctl.cli.settings import FOLLOWERS, TYPED_ONLY, SettingsCommand
from hexctl.settings import COMMON
from tests.cli.test_options import commands
from tests.server.processes import free_port

PAGE = Path(__file__).parents[2] / "docs" / "settings.md"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(text: str) -> None:
    Path("hexctl.toml").write_text(text)


def defaults(*words: str) -> dict[str, Any]:
    """Values of a command that are not those of its declaration, parsed as the program would; not run."""
    command: Any = typer.main.get_command(app)
    context = command.make_context("hexctl", list(words))
    arguments = [*context._protected_args, *context.args]
    while arguments and arguments[0] in getattr(command, "commands", {}):
        command = command.commands[arguments[0]]
        context = command.make_context(arguments[0], arguments[1:], parent=context)
        arguments = [*context._protected_args, *context.args] if isinstance(command, TyperGroup) else []
    flags = {param.name: param.opts[0].removeprefix("--").replace("-", "_") for param in command.params}
    return {
        flags[name]: value
        for name, value in context.params.items()
        if getattr(context.get_parameter_source(name), "name", "") == "DEFAULT_MAP"
    }


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert exit_code(words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    return printed.err.removeprefix("hexctl: ").rstrip("\n")


def test_every_command_follows_settings() -> None:
    assert all(isinstance(command, SettingsCommand) for _, command in commands())


def test_without_a_file_nothing_is_set() -> None:
    assert all(defaults(*path.split()[1:]) == {} for path in ("hexctl run", "hexctl serve", "hexctl status"))


def test_options_of_a_command_are_parsed_as_if_typed() -> None:
    write(
        "[run]\nduration = 20\nrealtime = true\nthen = ['wave@10', 'tripod@15']\nfailed-leg = 5\n"
        "gait = [5, 1, 2, 4, 3, 6]\nfailure = '5:weak:0.5'\n[prior.build]\nworlds = 50\n[see]\nfps = 10\n"
        "[sim.camera]\nsize = '640x480'\n"
    )
    assert defaults("run") == {
        "duration": 20.0,
        "realtime": True,
        "then": ["wave@10", "tripod@15"],
        "failed_leg": "5",
        "gait": "5,1,2,4,3,6",
        "failure": ["5:weak:0.5"],
    }
    assert defaults("prior", "build") == {"worlds": 50}
    assert defaults("see", "--camera", "0") == {"fps": 10.0}
    assert defaults("sim", "camera") == {"size": (640, 480)}
    assert defaults("adapt") == {}


def test_options_of_a_command_may_stand_beside_a_setting_of_its_name() -> None:
    write(
        "keys = 'certificates'\nrobot = 'pexod'\n[run]\nseed = 3\n"
        "[commands.keys.new]\ndays = 90\n[commands.run]\nduration = 20\n"
    )
    assert defaults("keys", "new") == {"days": 90}
    assert defaults("run") == {"robot": "pexod", "seed": 3, "duration": 20.0}
    assert defaults("status", "--connect", "tls/h:1") == {"keys": Path("certificates")}


def test_what_is_typed_comes_first_then_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    write("robot = 'pexod'\n[run]\nduration = 20\nseed = 3\nfailure = ['5:locked@8']\n")
    monkeypatch.setenv("HEXCTL_RUN_DURATION", "10")
    monkeypatch.setenv("HEXCTL_RUN_REALTIME", "yes")
    monkeypatch.setenv("HEXCTL_RUN_FAILURE", "2:limp@1 3:limp@2")
    assert defaults("run", "--seed", "4") == {
        "robot": "pexod",
        "duration": 10.0,
        "realtime": True,
        "failure": ["2:limp@1", "3:limp@2"],
    }
    assert "duration" not in defaults("run", "--duration", "5")
    monkeypatch.setenv("HEXCTL_ROBOT", "lukas")
    assert defaults("run")["robot"] == "lukas"


ON_NETWORK = 'backend = "zenoh"\nconnect = "tls/robot.local:7447"\nkeys = "keys"\n'
LINKED = {"connect": "tls/robot.local:7447", "keys": Path("keys")}
ON_PORT = 'backend = "dynamixel"\nconnect = "/dev/ttyUSB0:1000000"\nlisten = "tls/0.0.0.0:7447"\nkeys = "k"\n'


@pytest.mark.parametrize(
    ("text", "words", "set_"),
    [
        (ON_NETWORK, "run", {"backend": "zenoh", **LINKED}),
        (ON_NETWORK, "status", LINKED),
        (ON_NETWORK, "estop", LINKED),
        (ON_NETWORK, "see --camera 0", LINKED),
        (ON_NETWORK, "see --camera 0 --no-link", {}),
        (ON_NETWORK, "sim heal 5", LINKED),
        (ON_NETWORK, "run --backend sim", {}),
        (ON_NETWORK, "run --backend mavlink", {}),
        (ON_NETWORK, "run --connect tcp/127.0.0.1:7447", {"backend": "zenoh"}),
        (ON_NETWORK, "run --connect tls/other:7447", {"backend": "zenoh", "keys": Path("keys")}),
        (ON_NETWORK, "status --link lab.yaml", {"keys": Path("keys")}),
        (ON_NETWORK, "serve", {}),
        (ON_NETWORK, "sim board", {}),
        (ON_NETWORK, "view", {}),
        (ON_NETWORK, "view --connect tls/other:7447", {"keys": Path("keys")}),
        (ON_NETWORK, "adapt --resume x", {}),
        ('connect = "tcp/h:1"\nkeys = "keys"\n', "status", {"connect": "tcp/h:1"}),
        (
            ON_PORT,
            "serve",
            {
                "backend": "dynamixel",
                "connect": "/dev/ttyUSB0:1000000",
                "listen": "tls/0.0.0.0:7447",
                "keys": Path("k"),
            },
        ),
        (ON_PORT, "serve --backend sim", {"listen": "tls/0.0.0.0:7447", "keys": Path("k")}),
        (ON_PORT, "run", {"backend": "dynamixel", "connect": "/dev/ttyUSB0:1000000"}),
        (ON_PORT, "calibrate my.yaml", {"connect": "/dev/ttyUSB0:1000000"}),
        (ON_PORT, "servos scan", {"connect": "/dev/ttyUSB0:1000000"}),
        (ON_PORT, "servos scan --robot my.yaml", {"connect": "/dev/ttyUSB0:1000000"}),
        (ON_PORT, "servos set-id 3", {"connect": "/dev/ttyUSB0:1000000"}),
        (ON_PORT, "servos adopt --robot my.yaml --connect /dev/ttyUSB1", {}),
        ('connect = "/dev/ttyUSB0"\n', "servos test 3", {"connect": "/dev/ttyUSB0"}),
        ('connect = "/dev/i2c-1"\nbackend = "pca9685"\n', "servos identify", {}),
        ('connect = "udpin:127.0.0.1:14550"\nbackend = "mavlink"\n', "servos scan", {}),
        (ON_PORT, "sim board", {}),
        (ON_PORT, "status", {}),
        (ON_PORT, "estop", {}),
        (ON_NETWORK, "servos scan", {}),
        (ON_NETWORK, "calibrate my.yaml", {}),
        ('world = "rough"\n', "run", {"world": "rough"}),
        ('world = "rough"\n', "run --backend mock", {}),
        ('world = "rough"\n', "check", {}),
        ('robot = "lukas"\n', "check", {"robot": "lukas"}),
        ('robot = "lukas"\n', "check ant", {}),
        ('robot = "lukas"\n', "export ant --to urdf", {}),
        ('robot = "lukas"\n', "study", {}),
        ('robot = "lukas"\n', "see --camera 0", {}),
    ],
)
def test_a_command_follows_what_it_has_a_use_for(text: str, words: str, set_: dict[str, Any]) -> None:
    write(text)
    assert defaults(*words.split()) == set_


def test_paths_begin_at_the_folder_of_the_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write("robot = './my.yaml'\n[run]\nrecord = 'walk.rrd'\n[adapt]\nprior = './prior.npz'\n")
    (folder / ".git").mkdir()
    (folder / "below").mkdir()
    monkeypatch.chdir(folder / "below")
    assert defaults("run") == {"robot": str(folder / "my.yaml"), "record": folder / "walk.rrd"}
    assert defaults("adapt")["prior"] == str(folder / "prior.npz")


@pytest.mark.parametrize(
    ("text", "words", "line"),
    [
        ("[run]\nduration = -3", "run", "hexctl.toml: run.duration: got -3; allowed: above 0 up to 86400 s"),
        (
            "[run]\nduration = nan",
            "run",
            "hexctl.toml: run.duration: got nan; allowed: above 0 up to 86400 s",
        ),
        ("[run]\nduration = true", "run", "hexctl.toml: run.duration: got True; allowed: text or a number"),
        ("[run]\nrealtime = 1", "run", "hexctl.toml: run.realtime: got 1; allowed: true, false"),
        ("[run]\nthen = [1979-05-27]", "run", "hexctl.toml: run.then: got datetime.date(1979, 5, 27); "),
        (
            "[run]\nhold = 'lien'",
            "run",
            "hexctl.toml: run.hold: got lien; allowed: auto, line, heading, none",
        ),
        ("[run]\nduraton = 3", "run", "hexctl.toml: run.duraton: unknown option; "),
        ("[run.duration]\ns = 3", "run", "hexctl.toml: run.duration: got a table; allowed: one value"),
        ("run = 3", "status", "hexctl.toml: run: got 3; allowed: a table [run]"),
        (
            "[run]\nseed = 3\n[commands.run]\nseed = 3",
            "check",
            "hexctl.toml: commands.run.seed: is given twice; allowed: once",
        ),
        ("[commands.keys.new]\ndays = 0", "keys new", "hexctl.toml: commands.keys.new.days: got 0; "),
        ("[commands]\nrobot = 'ant'", "check", "hexctl.toml: commands.robot: got 'ant'; allowed: a table ["),
        ("[commands]\nseed = 3", "check", "hexctl.toml: commands.seed: unknown command; allowed: run, "),
        ("commands = 3", "check", "hexctl.toml: commands: unknown setting or command; "),
        ("robt = 'ant'", "sessions list", "hexctl.toml: robt: unknown setting or command; "),
        ("[sesions]\na = 1", "check", "hexctl.toml: sesions: unknown setting or command; "),
        (
            "[sessions.delete]\nyes = true",
            "check",
            "hexctl.toml: sessions.delete.yes: got True; allowed: only",
        ),
        ("[estop]\nclear = true", "check", "hexctl.toml: estop.clear: got True; allowed: only typed"),
        ("insecure = true", "check", "hexctl.toml: insecure: unknown setting"),
        ("[serve]\ninsecure = true", "check", "hexctl.toml: serve.insecure: got True; allowed: only typed"),
        ("robot = [", "check", "hexctl.toml: is not valid TOML: "),
    ],
)
def test_what_is_wrong_is_refused_with_file_and_key(
    text: str, words: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write(text)
    assert refused(words.split(), capsys).startswith(line)


def test_the_nearest_key_is_proposed(capsys: pytest.CaptureFixture[str]) -> None:
    write("[run]\nduraton = 3")
    assert refused(["run"], capsys).endswith("; did you mean 'duration'?")
    write("[rnu]\nduration = 3")
    assert refused(["run"], capsys).endswith("; did you mean 'run'?")


@pytest.mark.parametrize(
    ("variable", "line"),
    [
        ("HEXCTL_RUN_DURATON", "HEXCTL_RUN_DURATON: unknown option 'duraton'; "),
        ("HEXCTL_RUN_DURATION", "HEXCTL_RUN_DURATION: got 'x'; allowed: a number"),
        ("HEXCTL_RUN_REALTIME", "HEXCTL_RUN_REALTIME: got 'x'; allowed: true, false"),
        ("HEXCTL_SESSIONS_DELETE_YES", "HEXCTL_SESSIONS_DELETE_YES: allowed: only typed, as --yes"),
        ("HEXCTL_ROBTO", "HEXCTL_ROBTO: unknown variable; "),
    ],
)
def test_variables_are_checked_likewise(
    variable: str, line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(variable, "x")
    assert refused(["run"], capsys).startswith(line)


def test_an_error_of_the_library_names_the_place_too(capsys: pytest.CaptureFixture[str]) -> None:
    write("robot = 'bob'")
    assert exit_code(["check"]) == 2
    said, error = capsys.readouterr().err.splitlines()
    assert said == "hexctl: hexctl.toml sets --robot bob"
    assert "'bob'" in error


@pytest.mark.parametrize(
    "words",
    ["run", "adapt --failed-leg 5", "drive", "diagnose", "serve"],
)
@pytest.mark.parametrize("backend", ["mock", "mavlink"])
def test_a_world_is_left_out_with_a_robot_that_is_not_simulated(words: str, backend: str) -> None:
    write("world = 'rough'\nbackend = 'sim'\n")
    assert defaults(*words.split(), "--backend", backend) == {}
    assert defaults(*words.split())["world"] == "rough"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[run]\ntrim = 3", "run"),
        ("[run]\nhold = 'line'", "run --turn 20"),
        ("[sim.board]\nmodel = 'sts3215'", "sim board"),
        ("[sim.board]\nexpiry = 0.3", "sim board --bus feetech"),
        ("[study]\nprior = 'auto'", "study"),
    ],
)
def test_an_option_of_a_file_that_nothing_uses_is_left_out(text: str, words: str) -> None:
    write(text)
    assert defaults(*words.split()) == {}


def test_what_is_typed_and_useless_is_refused_and_skipped_in_a_file(
    capsys: pytest.CaptureFixture[str],
) -> None:
    write("[run]\nworld = 'rough'\nrealtime = true\n[study]\nseed = 3\ngaits = 'demo'")
    assert defaults("run", "--backend", "mock") == {}
    assert defaults("run") == {"world": "rough", "realtime": True}
    assert defaults("study") == {"seed": 3}
    write("")
    assert refused(["run", "--backend", "mock", "--world", "rough"], capsys).startswith("--world: got rough")


def test_help_is_there_whatever_is_wrong(capsys: pytest.CaptureFixture[str]) -> None:
    write("robot = [")
    for words in ([], ["run"], ["see"], ["prior", "build"]):
        assert exit_code([*words, "--help"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", ["robot = [", "robt = 1", "connect = true", "keys = 3\n[estop]\nclear = true"]
)
def test_a_stop_is_asked_for_whatever_is_wrong(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    write(text)
    assert exit_code(["estop", "--connect", "tcp/127.0.0.1:1"]) == 3
    *told, early, last = capsys.readouterr().err.splitlines()
    assert all(line.startswith("hexctl: nothing listens at tcp/127.0.0.1:1") for line in (early, last))
    assert told
    assert all(line.startswith("hexctl: hexctl.toml: ") for line in told)


def test_a_setting_of_the_table_of_consent_exists_as_an_option() -> None:
    flags = {name for _, command in commands() for param in command.params for name in param.opts}
    assert {f"--{option}" for option in TYPED_ONLY} <= flags
    assert {f"--{option}" for option in FOLLOWERS} <= flags
    assert set(FOLLOWERS) | {"runs"} == set(COMMON)


def test_the_page_says_what_is_accepted() -> None:
    text = PAGE.read_text(encoding="utf-8")
    write(re.findall(r"```toml\n(.*?)```", text, re.DOTALL)[0])
    assert defaults("run")["duration"] == 20.0
    assert defaults("prior", "build")["worlds"] == 50
    assert all(f"`{key}`" in text and f"`HEXCTL_{key.upper()}`" in text for key in COMMON)
    assert all(f"`--{option}`" in text for option in TYPED_ONLY)


def hexctl(*words: str, **variables: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "hexctl", *words],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def followed(said: str) -> dict[str, set[str]]:
    """Options that a command follows, by file or variable, as it says them on stderr."""
    lines = re.findall(r"^hexctl: (\S+) sets (.*)$", said, re.MULTILINE)
    return {place: set(options.split(", ")) for place, options in lines}


@pytest.mark.realtime
def test_a_process_walks_by_its_settings_and_keeps_runs_where_they_say() -> None:
    write("robot = 'pexod'\nruns = 'out'\nbackend = 'mock'\n[run]\nduration = 0.2\njson = true\n")
    done = hexctl("run", HEXCTL_RUN_GAIT="tripod")
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert (outcome["robot"], outcome["gait"]["name"]) == ("pexod", "tripod")
    assert outcome["duration_s"] == pytest.approx(0.2, abs=0.021)
    assert Path(outcome["recording"]).parent == Path("out")
    assert followed(done.stderr) == {
        "hexctl.toml": {"--backend mock", "--robot pexod", "--duration 0.2", "--json"},
        "HEXCTL_RUN_GAIT": {"--gait tripod"},
    }
    assert not Path("runs").exists()
    other = hexctl(
        "run", "--no-record", HEXCTL_SETTINGS="none", HEXCTL_BACKEND="mock", HEXCTL_RUN_DURATION="0.1"
    )
    assert other.returncode == 0, other.stderr
    assert other.stdout.startswith("ant on mock")


@pytest.mark.realtime
def test_a_process_serves_and_others_find_and_stop_it_by_one_file(folder: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    write(f"robot = 'lukas'\nlisten = '{endpoint}'\nconnect = '{endpoint}'\n[serve]\nbackend = 'mock'\n")
    served = subprocess.Popen(
        [sys.executable, "-u", "-m", "hexctl", "serve"], stderr=subprocess.PIPE, text=True, cwd=folder
    )
    assert served.stderr is not None
    try:
        said = [served.stderr.readline() for _ in range(2)]
        assert followed(said[0]) == {
            "hexctl.toml": {"--backend mock", "--robot lukas", f"--listen {endpoint}"}
        }
        assert said[1].startswith(f"serving lukas (mock) at {endpoint},")
        status = hexctl("status", "--json")
        assert status.returncode == 0, status.stderr
        assert json.loads(status.stdout)["robot"] == "lukas"
        write(f"connect = '{endpoint}'\nrobt = 1\n")
        stopped = hexctl("estop", "--json")
        assert stopped.returncode == 0, stopped.stderr
        assert json.loads(stopped.stdout)["stopped"]
        assert "robt: unknown setting" in stopped.stderr
    finally:
        served.terminate()
        served.wait(30)
        served.stderr.close()


def test_without_a_command_nothing_of_the_settings_is_loaded() -> None:
    program = (
        "import sys\nfrom hexctl.cli.main import exit_code\nexit_code(['--help'])\n"
        "print([name for name in ('hexctl.settings', 'tomllib') if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "[]"
