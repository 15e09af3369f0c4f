"""Settings: which files and variables are found, and what commands follow of them."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.core import TyperGroup

import hexctl
from hexctl.cli.main import app
from hexctl.cli.settings import FOLLOWERS, TYPED_ONLY, SettingsCommand
from hexctl.settings import COMMON, find_settings, settings_files
from tests.cli.conftest import Call
from tests.cli.test_options import commands
from tests.server.processes import free_port, program

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "command-line.md"


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


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The home folder, whose `project` is the working folder."""
    home = tmp_path / "home"
    (home / "project" / "deep").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(home / "project")
    return home


@pytest.mark.usefixtures("home")
def test_variables_come_before_the_folders_file_and_that_before_the_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (hexctl.read_settings().values, hexctl.read_settings().runs) == ({}, Path("runs"))
    (tmp_path / "config" / "hexctl").mkdir(parents=True)
    (tmp_path / "config" / "hexctl" / "hexctl.toml").write_text(
        'robot = "pexod"\nworld = "rough"\nbackend = "mock"\n[run]\nduration = 5\nseed = 1\n'
    )
    write('robot = "phantomx"\nbackend = "sim"\n[run]\nduration = 7\n')
    monkeypatch.setenv("HEXCTL_ROBOT", "ant")
    monkeypatch.setenv("HEXCTL_WORLD", "")  # empty is not said
    settings = hexctl.read_settings()
    assert settings.values == {"robot": "ant", "backend": "sim", "world": "rough"}
    assert settings.origins["robot"] == "HEXCTL_ROBOT"
    assert settings.origins["backend"] == "hexctl.toml: backend"
    assert settings.of("run") == {"duration": 7, "seed": 1}


def test_the_nearest_file_above_counts_up_to_the_home_folder_and_a_repository(home: Path) -> None:
    (home.parent / "hexctl.toml").write_text("")
    assert settings_files(home / "project" / "deep") == ()
    (home / "hexctl.toml").write_text("")
    assert settings_files(home / "project" / "deep") == (home / "hexctl.toml",)
    nearer = home / "project" / "hexctl.toml"
    nearer.write_text("")
    assert settings_files(home / "project" / "deep") == (nearer,)
    nearer.unlink()
    (home / "project" / ".git").mkdir()
    assert settings_files(home / "project" / "deep") == ()


@pytest.mark.usefixtures("home")
def test_outside_of_home_and_repositories_only_the_folder_itself_counts(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    (shared / "mine").mkdir(parents=True)
    (shared / "hexctl.toml").write_text("")
    assert settings_files(shared / "mine") == ()
    assert settings_files(shared) == (shared / "hexctl.toml",)


def test_a_variable_names_the_only_file_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write('robot = "pexod"')
    monkeypatch.setenv("HEXCTL_SETTINGS", "none")
    assert hexctl.read_settings().values == {}
    other = tmp_path / "other.toml"
    other.write_text('robot = "lukas"')
    monkeypatch.setenv("HEXCTL_SETTINGS", str(other))
    assert hexctl.read_settings().values == {"robot": "lukas"}
    for name in (str(tmp_path / "gone.toml"), "~nobody-of-this-name/gone.toml"):
        monkeypatch.setenv("HEXCTL_SETTINGS", name)
        with pytest.raises(hexctl.InputError, match=r"gone\.toml: cannot be read: No such file"):
            hexctl.read_settings()


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"robot = [", r"^hexctl\.toml: is not valid TOML: Invalid value"),
        (b"\xff\xfe", r"^hexctl\.toml: cannot be read as text"),
        (b"robot = 3", r"^hexctl\.toml: robot: got 3; allowed: text, a shipped name or a robot file$"),
        (b'robot = ""', r"^hexctl\.toml: robot: got ''; allowed: text"),
        (b'runs = "a\\u0000b"', r"^hexctl\.toml: runs: got 'a.x00b'; allowed: text without null"),
        (b"run.a-b = 1\nrun.a_b = 2", r"^hexctl\.toml: run\.a-b: is given twice"),
        (b"x = 1\n" * 200_000, r"^hexctl\.toml: cannot be read: it is larger than 0\.1 MB"),
        (b"a." * 3000 + b"b = 1", r"^hexctl\.toml: is not valid TOML"),
        (b"x = " + b"[" * 5000, r"^hexctl\.toml: is not valid TOML"),
    ],
)
def test_a_damaged_file_is_one_line(content: bytes, line: str) -> None:
    Path("hexctl.toml").write_bytes(content)
    with pytest.raises(hexctl.InputError, match=line) as caught:
        hexctl.read_settings()
    assert len(str(caught.value).splitlines()) == 1
    assert find_settings().problems == (str(caught.value),)


def test_a_file_that_is_a_folder_or_leads_nowhere_is_one_line() -> None:
    Path("hexctl.toml").symlink_to("nowhere")
    with pytest.raises(hexctl.InputError, match=r"^hexctl\.toml: cannot be read: No such file"):
        hexctl.read_settings()
    Path("hexctl.toml").unlink()
    Path("hexctl.toml").mkdir()
    with pytest.raises(hexctl.InputError, match=r"^hexctl\.toml: cannot be read: it is a pipe, a device"):
        hexctl.read_settings()


def test_every_command_follows_settings() -> None:
    assert all(isinstance(command, SettingsCommand) for _, command in commands())


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


def test_paths_begin_at_the_folder_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write("robot = './my.yaml'\n[run]\nrecord = 'walk.rrd'\n[adapt]\nprior = './prior.npz'\n")
    (tmp_path / ".git").mkdir()
    (tmp_path / "below").mkdir()
    monkeypatch.chdir(tmp_path / "below")
    assert defaults("run") == {"robot": str(tmp_path / "my.yaml"), "record": tmp_path / "walk.rrd"}
    assert defaults("adapt")["prior"] == str(tmp_path / "prior.npz")


def test_an_error_of_the_library_names_the_place_too(call: Call) -> None:
    write("robot = 'bob'")
    said, error = call("check", code=2).err.splitlines()
    assert said == "hexctl: hexctl.toml sets --robot bob"
    assert "'bob'" in error


def test_help_is_there_whatever_is_wrong(call: Call) -> None:
    write("robot = [")
    for words in ("--help", "run --help", "see --help", "prior build --help"):
        assert call(words).err == ""


@pytest.mark.slow
@pytest.mark.parametrize("text", ["robot = [", "keys = 3\n[estop]\nclear = true"])
def test_a_stop_is_asked_for_whatever_is_wrong(text: str, call: Call) -> None:
    write(text)
    *told, early, last = call("estop --connect tcp/127.0.0.1:1", code=3).err.splitlines()
    assert all(line.startswith("hexctl: nothing listens at tcp/127.0.0.1:1") for line in (early, last))
    assert told
    assert all(line.startswith("hexctl: hexctl.toml: ") for line in told)


@pytest.mark.parametrize("place", ["/dev/ttyUSB0", "1", "udpout:127.0.0.1:14550"])
def test_a_port_of_servos_is_no_endpoint(place: str, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    write(f"connect = '{place}'")
    assert f"hexctl.toml: connect: got '{place}'" in call("status", code=2).refusal
    monkeypatch.setenv("HEXCTL_SETTINGS", "none")
    monkeypatch.setenv("HEXCTL_CONNECT", place)
    assert call("run", code=2).refusal.endswith("the port of servos is `port`")


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


def followed(said: str) -> dict[str, set[str]]:
    """Options that a command follows, by file or variable, as it says them on stderr."""
    lines = re.findall(r"^hexctl: (\S+) sets (.*)$", said, re.MULTILINE)
    return {place: set(options.split(", ")) for place, options in lines}


ON_NETWORK = 'backend = "zenoh"\nconnect = "tls/robot.local:7447"\nkeys = "keys"\n'
LINKED = {"connect": "tls/robot.local:7447", "keys": Path("keys")}
ON_PORT = 'backend = "dynamixel"\nport = "/dev/ttyUSB0:1000000"\nlisten = "tls/0.0.0.0:7447"\nkeys = "k"\n'
PORT = {"port": "/dev/ttyUSB0:1000000"}
SERVED = {"listen": "tls/0.0.0.0:7447", "keys": Path("k")}
WALKS = ("run", "adapt --failed-leg 5", "drive", "diagnose", "serve")

#: A file, a command, and what it follows.
FOLLOWED: list[tuple[str, str, dict[str, Any]]] = [
    ("", "run", {}),
    (ON_NETWORK, "run", {"backend": "zenoh", **LINKED}),
    (ON_NETWORK, "estop", LINKED),
    (ON_NETWORK, "see --camera 0", LINKED),
    (ON_NETWORK, "see --camera 0 --no-link", {}),
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
    (ON_NETWORK, "servos scan", {}),
    ('connect = "tcp/h:1"\nkeys = "keys"\n', "status", {"connect": "tcp/h:1"}),
    (ON_PORT, "serve", {**PORT, "backend": "dynamixel", **SERVED}),
    (ON_PORT, "serve --backend sim", SERVED),
    (ON_PORT, "run", {**PORT, "backend": "dynamixel"}),
    (ON_PORT, "calibrate my.yaml", PORT),
    (ON_PORT, "servos scan --robot my.yaml", PORT),
    (ON_PORT, "servos adopt --robot my.yaml --port /dev/ttyUSB1", {}),
    (ON_PORT, "status", {}),
    (ON_PORT, "run --backend zenoh", {}),
    (ON_PORT, "sim board", {}),
    (ON_PORT + ON_NETWORK.partition("\n")[2].partition("keys")[0], "run", {**PORT, "backend": "dynamixel"}),
    *(('world = "rough"\nbackend = "sim"\n', f"{words} --backend mock", {}) for words in WALKS),
    *(('world = "rough"\n', words, {"world": "rough"}) for words in WALKS),
    ('world = "rough"\n', "check", {}),
    ('robot = "lukas"\n', "check", {"robot": "lukas"}),
    ('robot = "lukas"\n', "check ant", {}),
    ('robot = "lukas"\n', "sim board", {"robot": "lukas"}),
    ('robot = "lukas"\n', "study", {}),
    ("[run]\ntrim = 3", "run", {}),
    ("[run]\nhold = 'line'", "run --turn 20", {}),
    ("[sim.board]\nmodel = 'sts3215'", "sim board", {}),
    ("[sim.board]\nexpiry = 0.3", "sim board --bus feetech", {}),
    ("[study]\nseed = 3\ngaits = 'demo'\nprior = 'auto'", "study", {"seed": 3}),
    ("[prior.build]\nfailure = 'limp'\nduration = 8\n", "prior build --repertoire", {}),
    (ON_NETWORK, "identify", {"backend": "zenoh", **LINKED}),
    (ON_NETWORK, "identify walk.rrd", {}),
    ("[identify]\np-gain = 16", "identify", {}),
    ("[identify]\np-gain = 16", "identify walk.rrd", {}),
    ("[identify]\np-gain = 16", "identify run.json", {"p_gain": 16.0}),
]


@pytest.mark.parametrize(("text", "words", "followed"), FOLLOWED)
def test_a_command_follows_what_it_has_a_use_for(text: str, words: str, followed: dict[str, Any]) -> None:
    write(text)
    assert defaults(*words.split()) == followed


@pytest.mark.parametrize(
    ("text", "words", "key"),
    [
        ("[run]\nduration = -3", "run", "run.duration"),
        ("[run]\nduration = nan", "run", "run.duration"),
        ("[run]\nduration = true", "run", "run.duration"),
        ("[run]\nrealtime = 1", "run", "run.realtime"),
        ("[run]\nthen = [1979-05-27]", "run", "run.then"),
        ("[run]\nhold = 'lien'", "run", "run.hold"),
        ("[run]\nduraton = 3", "run", "run.duraton"),
        ("[run.duration]\ns = 3", "run", "run.duration"),
        ("run = 3", "status", "run"),
        ("[run]\nseed = 3\n[commands.run]\nseed = 3", "check", "commands.run.seed"),
        ("[commands.keys.new]\ndays = 0", "keys new", "commands.keys.new.days"),
        ("[commands]\nrobot = 'ant'", "check", "commands.robot"),
        ("[commands]\nseed = 3", "check", "commands.seed"),
        ("commands = 3", "check", "commands"),
        ("robt = 'ant'", "sessions list", "robt"),
        ("[sesions]\na = 1", "check", "sesions"),
        ("[sessions.delete]\nyes = true", "check", "sessions.delete.yes"),
        ("[estop]\nclear = true", "check", "estop.clear"),
        ("insecure = true", "check", "insecure"),
        ("[serve]\ninsecure = true", "check", "serve.insecure"),
        ("robot = [", "check", "is not valid TOML"),
    ],
)
def test_what_is_wrong_is_refused_with_file_and_key(text: str, words: str, key: str, call: Call) -> None:
    write(text)
    assert call(words, code=2).refusal.startswith(f"hexctl: hexctl.toml: {key}: ")


@pytest.mark.parametrize(
    "variable",
    ["RUN_DURATON", "RUN_DURATION", "RUN_REALTIME", "SESSIONS_DELETE_YES", "ROBTO"],
)
def test_variables_are_checked_likewise(variable: str, monkeypatch: pytest.MonkeyPatch, call: Call) -> None:
    monkeypatch.setenv(f"HEXCTL_{variable}", "x")
    assert call("run", code=2).refusal.startswith(f"hexctl: HEXCTL_{variable}: ")


@pytest.mark.slow
def test_a_walk_follows_its_settings_and_keeps_runs_where_they_say(
    monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    write("robot = 'pexod'\nruns = 'out'\nbackend = 'mock'\n[run]\nduration = 0.2\njson = true\n")
    monkeypatch.setenv("HEXCTL_RUN_GAIT", "tripod")
    printed = call("run")
    outcome = printed.json
    assert (outcome["robot"], outcome["gait"]["name"]) == ("pexod", "tripod")
    assert outcome["duration_s"] == pytest.approx(0.2, abs=0.021)
    assert Path(outcome["recording"]).parent == Path("out")
    assert followed(printed.err) == {
        "hexctl.toml": {"--backend mock", "--robot pexod", "--duration 0.2", "--json"},
        "HEXCTL_RUN_GAIT": {"--gait tripod"},
    }
    assert not Path("runs").exists()
    monkeypatch.setenv("HEXCTL_SETTINGS", "none")
    assert defaults("run") == {"gait": "tripod"}


@pytest.mark.realtime
def test_a_process_serves_and_others_find_and_stop_it_by_one_file(tmp_path: Path, call: Call) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    write(f"robot = 'lukas'\nlisten = '{endpoint}'\nconnect = '{endpoint}'\n[serve]\nbackend = 'mock'\n")
    with program(
        tmp_path, "robot", "hexctl", "serve", HEXCTL_SETTINGS=str(tmp_path / "hexctl.toml")
    ) as robot:
        robot.wait_for(f"serving lukas (mock) at {endpoint},")
        assert call("status --json").json["robot"] == "lukas"
        write(f"connect = '{endpoint}'\nrobt = 1\n")
        stopped = call("estop --json")
        assert json.loads(stopped.out)["stopped"]
        assert "robt" in stopped.err
