"""What hexctl did before, it still does: physics, choices, stored sessions, and the shape of what it writes.

The data under `tests/data` was written by `tests.golden.make`, from the code as it was when the data came in.
New commands, options, keys, entities and columns may come; none may go, and no number may change.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hexctl.cli.main import app, exit_code
from tests.golden import choices, stored, trials
from tests.golden.make import DATA, PRINTED
from tests.server.processes import served, stopped_by_session

Printed = Callable[[str], Any]

#: On another machine the last bits may differ, and contacts of feet amplify that over a walk.
ELSEWHERE_M = 0.01
AMPLIFIED = {"path", "clipped_ticks", "commanded_rad", "measured_rad", "base_position_world"}


def kept(name: str) -> Any:
    """A file of the data."""
    return json.loads((DATA / name).read_text(encoding="utf-8"))


TRIALS, CHOICES, SESSIONS, SHAPES = (
    kept(f"{name}.json") for name in ("trials", "choices", "sessions", "shapes")
)
SAME_BITS = TRIALS["probe"] == trials.probe()


def assert_same(now: Any, before: Any) -> None:
    """To the last bit where the machine computes as the one did that wrote the data, else nearly."""
    if SAME_BITS:
        assert now == before
    else:
        assert_near(now, before)


def assert_near(now: Any, before: Any) -> None:
    """The same values, but for what contacts make of a last bit."""
    if isinstance(before, dict):
        assert now.keys() == before.keys()
        for key in before.keys() - AMPLIFIED:
            assert_near(now[key], before[key])
    elif isinstance(before, list):
        assert len(now) == len(before)
        for one, other in zip(now, before, strict=True):
            assert_near(one, other)
    elif isinstance(before, float):
        assert now == pytest.approx(before, abs=ELSEWHERE_M)
    else:
        assert now == before


@pytest.mark.slow
@pytest.mark.parametrize("name", TRIALS["results"])
def test_a_trial_alone(name: str) -> None:
    result, log = trials.alone(trials.trials()[name])
    assert_same(result, TRIALS["results"][name])
    assert_same(log, TRIALS["logs"][name])


@pytest.mark.slow
def test_trials_in_one_batch() -> None:
    cases = trials.trials()
    turned = cases.pop("turned by an angle")
    for name, result in zip(cases, trials.together(list(cases.values())), strict=True):
        assert_same(result, TRIALS["results"][name])
    assert_same(trials.together([turned])[0], TRIALS["results"]["turned by an angle"])


@pytest.mark.parametrize("case", choices.BELIEVED)
def test_choices_of_bayes_with_the_shipped_prior(case: str) -> None:
    assert_same(choices.believed(*choices.BELIEVED[case]), CHOICES["bayes"][case])


def test_choices_of_the_heuristics() -> None:
    for name, seed in choices.SEARCHES:
        assert choices.bare(name, seed) == CHOICES["bare"][f"{name} {seed}"]
        assert choices.asked(name, seed) == CHOICES["asked"][f"{name} {seed}"]


@pytest.fixture
def printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Printed:
    """What a command prints as JSON, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").symlink_to(Path(__file__).parents[1] / "configs")

    def run(line: str) -> Any:
        capsys.readouterr()
        code = exit_code([*line.split(), "--json"])
        said = capsys.readouterr()
        # A walk in real time is stopped where the machine has no time for it for 0.2 s; it says as much.
        assert code == 0 or (code == 3 and "mock" in line), said.err
        return json.loads(said.out)

    return run


@pytest.mark.slow
@pytest.mark.parametrize("name", SESSIONS)
def test_a_stored_session_is_shown_and_goes_on_as_it_would_have(
    name: str, printed: Printed, tmp_path: Path
) -> None:
    stored.unpack(tmp_path)
    shown = printed(f"sessions show {name}")
    assert len(shown["trials"]) == stored.BEGUN[name][1]
    after = stored.course(printed(f"adapt {stored.CONTINUED[name]} --no-record"))
    assert_same(after, SESSIONS[name])


def test_stored_sessions_are_listed(printed: Printed, tmp_path: Path) -> None:
    stored.unpack(tmp_path)
    assert {row["session"] for row in printed("sessions list")} == set(SESSIONS)


def assert_keeps(now: Any, before: Any, where: str = "") -> None:
    """Every key of before is there and of its kind; what was null may be anything."""
    if isinstance(before, dict):
        assert isinstance(now, dict), where
        for key, inner in before.items():
            assert key in now, f"{where}.{key} is gone"
            assert_keeps(now[key], inner, f"{where}.{key}")
    elif isinstance(before, list):
        assert isinstance(now, list), where
        for one, other in zip(now, before, strict=bool(before)):
            assert_keeps(one, other, f"{where}[]")
    elif before != "null":
        assert now == before, where


@pytest.mark.slow
def test_json_of_the_commands(printed: Printed, tmp_path: Path) -> None:
    for name, line in PRINTED.items():
        assert_keeps(stored.of_json(printed(line)), SHAPES["json"][name], name)
    with served(tmp_path, backend="sim") as robot:
        status = printed(f"status --connect {robot.endpoint}")
        assert_keeps(stored.of_json(status), SHAPES["json"]["status"], "status")
        estop = stopped_by_session(
            lambda: printed(f"estop --connect {robot.endpoint}"), lambda answer: bool(answer["robots"])
        )
        assert_keeps(stored.of_json(estop), SHAPES["json"]["estop"], "estop")


@pytest.mark.slow
def test_recordings_and_tables(printed: Printed, tmp_path: Path) -> None:
    printed(PRINTED["run"])
    session = printed("adapt --failed-leg 5 --budget 2 --optimizer random --duration 1")
    for name, answer in (
        ("adapt", session),
        ("sessions list", printed("sessions list")),
        ("sessions show", printed(f"sessions show {session['session']}")),
    ):
        assert_keeps(stored.of_json(answer), SHAPES["json"][name], name)
    exit_code(["export", session["session"], "--output", "out.csv"])
    columns = (tmp_path / "out.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert columns[: len(SHAPES["table"])] == SHAPES["table"]
    folder = tmp_path / "runs" / session["session"]
    assert {path.name for path in folder.iterdir()} >= set(SHAPES["files"])
    for name, path in (("run", tmp_path / "walk.rrd"), ("adapt", folder / "overview.rrd")):
        now, before = stored.of_recording(path), SHAPES["recordings"][name]
        assert now["application"] == before["application"]
        assert set(now["timelines"]) >= set(before["timelines"])
        assert now["blueprints"] == before["blueprints"]
        for entity, kept_columns in before["entities"].items():
            assert entity in now["entities"], f"{entity} is gone"
            for column, rows in kept_columns.items():
                found = now["entities"][entity].get(column)
                assert found is not None, f"{column} of {entity} is gone"
                assert found == rows or not SAME_BITS, f"{column} of {entity}"


def test_commands_and_options() -> None:
    now = stored.of_commands(app)
    for command, options in SHAPES["commands"].items():
        assert command in now, f"hexctl {command} is gone"
        assert set(now[command]) >= set(options), f"hexctl {command}"


def test_the_data_is_small_and_names_no_machine() -> None:
    for path in filter(Path.is_file, DATA.rglob("*")):
        content = path.read_bytes()
        assert len(content) < (500_000 if path.suffix == ".npz" else 200_000)
        assert b"/tmp/" not in content
        assert b"/home/" not in content
