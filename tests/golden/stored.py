"""What hexctl stores and prints: sessions and how they go on, and the shapes of files, JSON and options."""

import shutil
from pathlib import Path
from typing import Any

import rerun as rr
import typer

#: The sessions of before, as they lie in `runs/`.
STORE = Path(__file__).parents[1] / "data" / "sessions"

#: What was asked for: name in the store, options, and how many trials were kept of it.
BEGUN = {
    "whole-bayes": ("--failed-leg 5 --budget 3 --seed 1 --target 0.0001 --worth 0", 3),
    "cut-bayes": ("--failed-leg 2 --budget 4 --seed 1 --target 0.0001 --worth 0", 2),
    "whole-pso": ("--failed-leg 2 --budget 8 --seed 3 --optimizer pso --duration 2", 8),
    "cut-pso": ("--failed-leg 2 --budget 8 --seed 3 --optimizer pso --duration 2", 4),
    "cut-dps": ("--failed-leg 6 --budget 6 --confirm 2 --seed 4 --optimizer dps --duration 1", 3),
}

#: How each is continued.
CONTINUED = {
    "whole-bayes": "--resume whole-bayes --budget 4",
    "cut-bayes": "--resume cut-bayes",
    "whole-pso": "--resume whole-pso --budget 10",
    "cut-pso": "--resume cut-pso",
    "cut-dps": "--resume cut-dps",
}

#: The prior's place in a stored session: below the folder in which it is continued.
PRIOR = "priors/ant-locked-rear-30s.npz"


def unpack(folder: Path) -> None:
    """Put the store of before and the prior its sessions believe into a folder."""
    shutil.copytree(STORE, folder / "runs")
    place_prior(folder)


def place_prior(folder: Path) -> None:
    """Put the prior that the stored sessions believe, shipped when they began, where they expect it."""
    (folder / PRIOR).parent.mkdir()
    shutil.copy(STORE.parent / Path(PRIOR).name, folder / PRIOR)


def keep(source: Path, target: Path, trials: int) -> None:
    """Copy the folder of a session, as if it had been cut off after some trials unless it has no more."""
    *lines, end = (source / "session.jsonl").read_text(encoding="utf-8").splitlines(keepends=True)
    walks = [line for line in lines if line.startswith('{"trial"')]
    if trials < len(walks):
        lines = lines[: lines.index(walks[trials])]
    target.mkdir(parents=True)
    (target / "session.jsonl").write_text(
        "".join(lines if trials < len(walks) else [*lines, end]), encoding="utf-8"
    )


def course(session: dict[str, Any]) -> dict[str, Any]:
    """What a session's `--json` says of its course."""
    return {
        "codes": [trial["code"] for trial in session["trials"]],
        "scores": [trial["score"] for trial in session["trials"]],
        "statuses": [trial["status"] for trial in session["trials"]],
        "confirms": [trial["confirms"] for trial in session["trials"]],
        "best": session["best"] and session["best"]["code"],
        "ended": session["ended"],
    }


def of_json(value: Any) -> Any:
    """Keys and kinds of a JSON value; a list counts by its first element."""
    if isinstance(value, dict):
        return {key: of_json(inner) for key, inner in sorted(value.items())}
    if isinstance(value, list):
        return [of_json(value[0])] if value else []
    kinds = {bool: "truth", int: "number", float: "number", str: "text", type(None): "null"}
    return kinds[type(value)]


def of_recording(path: Path) -> dict[str, Any]:
    """Entities of a recording, each with its columns and how many rows each has, and its properties."""
    reader = rr.chunk.RrdReader(path)
    entities: dict[str, dict[str, int]] = {}
    timelines: set[str] = set()
    for chunk in reader.stream().to_chunks():
        batch = chunk.to_record_batch()
        columns = entities.setdefault(chunk.entity_path, {})
        for name in batch.schema.names:
            if name.startswith("rerun.controls"):
                continue
            if ":" in name or chunk.is_static:
                rows = len(batch) - batch.column(name).null_count
                columns[name] = columns.get(name, 0) + rows
            else:
                timelines.add(name)
    return {
        "application": reader.recordings()[0].application_id,
        "timelines": sorted(timelines),
        "blueprints": len(reader.blueprints()),
        "entities": {name: dict(sorted(columns.items())) for name, columns in sorted(entities.items())},
    }


def of_commands(app: typer.Typer) -> dict[str, list[str]]:
    """Names of all commands, each with its arguments and options."""
    found: dict[str, list[str]] = {}

    def collect(command: Any, words: tuple[str, ...]) -> None:
        for name, inner in getattr(command, "commands", {}).items():
            collect(inner, (*words, name))
        if not hasattr(command, "commands"):
            names = [
                name for parameter in command.params for name in parameter.opts + parameter.secondary_opts
            ]
            found[" ".join(words)] = sorted(names)

    collect(typer.main.get_command(app), ())
    return dict(sorted(found.items()))
