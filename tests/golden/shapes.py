"""The shape of what hexctl writes: entities of a recording, keys of its JSON, options of its commands."""

from pathlib import Path
from typing import Any

import rerun as rr
import typer


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
