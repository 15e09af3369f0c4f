"""Tables of trials: of one session in a CSV or Parquet file, or of all sessions."""

import csv
from pathlib import Path
from typing import Any

from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.store import RUNS, list_sessions, load_session
from hexctl.adapt.sessions.walk_records import BASELINE_GAITS, TrialRecord
from hexctl.control.planning.top_speed import STRIDE
from hexctl.errors import InputError, MissingExtraError
from hexctl.files import OnDamage

#: Parts of the prediction of a trial, a column each.
EXPECTED = ("signed_m", "low_m", "high_m", "chance")

#: Fields of `SessionSpec` that come last in an exported row.
ASKED_COLUMNS = ("robot", "world", "failure", "duration_s", "target_m")

#: Fields of `SessionSpec` in each row.
SPEC_COLUMNS = ("robot", "world", "failure", "objective", "duration_s", "backend")

#: Texts that all trials may lack; numbers that they lack are floats, except for `failed_leg`.
TEXTS = ("stopped", "hold", "recording", "cause", "world", *(f"baseline_{x}_status" for x in BASELINE_GAITS))

#: Columns that an empty table has, so that a question about it has an answer.
USUAL_COLUMNS = (
    "session",
    "created",
    *SPEC_COLUMNS,
    *("optimizer", "failed_leg", "seed", "index", "code", "slots", "score", "status", "walked_s"),
    *("distance_m", "deviation_signed_m", "energy_j", "cost_of_transport"),
)


def flat_rows(session: Session) -> list[dict[str, Any]]:
    """Rows, one per trial; empty for a session without trials.

    The baseline has its own columns, equal in all rows: its own row would look like a trial.
    """
    spec = session.spec.as_json()
    head = {"session": session.name, **{name: spec[name] for name in ("optimizer", "failed_leg", "seed")}}
    last = _baseline_columns(session) | {name: spec[name] for name in ASKED_COLUMNS}
    return [head | _trial_columns(trial) | last for trial in session.trials]


def _trial_columns(trial: TrialRecord) -> dict[str, Any]:
    values = trial.as_json()
    deviation, stride = values.pop("deviation_m"), values.pop("stride") or dict.fromkeys(STRIDE)
    expected = values.pop("expected") or {}
    return {
        **values,
        "slots": " ".join(map(str, trial.slots)),
        **{f"deviation_{name}_m": value for name, value in deviation.items()},
        **{f"expected_{name}": expected.get(name) for name in EXPECTED},
        **stride,
    }


def _baseline_columns(session: Session) -> dict[str, Any]:
    walked = {walk.gait: walk.as_json() for walk in session.baseline}
    columns: dict[str, Any] = {}
    for gait in dict.fromkeys((*BASELINE_GAITS[1:], *BASELINE_GAITS, *walked)):
        walk = walked.get(gait, {})
        columns[f"baseline_{gait}_score"] = walk.get("score")
        columns[f"baseline_{gait}_deviation_m"] = walk.get("deviation_m", {}).get("signed")
        columns[f"baseline_{gait}_distance_m"] = walk.get("distance_m")
        columns[f"baseline_{gait}_status"] = walk.get("status")
    return columns


def export_session(name: str, kind: str, path: Path, folder: Path, *, on_damage: OnDamage) -> None:
    """Write a session's trials, without damaged ones, to a new file of a kind, `csv` or `parquet`.

    Raises InputError for an unknown name, or a session without trials; StoreError for a damaged session;
    MissingExtraError without a library for the kind.
    """
    session = load_session(name, folder, on_damage=on_damage)
    if not session.trials:
        raise InputError(f"session {session.name}: has no trials to export")
    rows = flat_rows(session)
    if kind == "csv":
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fieldnames=list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
        return
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError as error:
        raise MissingExtraError("Parquet export", "study") from error
    table, empty = pa.Table.from_pylist(rows), dict.fromkeys(TEXTS, pa.string()) | {"failed_leg": pa.int64()}
    types = [empty.get(one.name, pa.float64()) if one.type == pa.null() else one.type for one in table.schema]
    pq.write_table(table.cast(pa.schema(zip(table.schema.names, types, strict=True))), path)


def sessions(folder: Path | str = RUNS) -> Any:
    """All trials of all sessions of a folder, a row each.

    Columns are those of an exported session (`session`, `optimizer`, `failed_leg`, `slots`, `score`,
    `status`, `deviation_signed_m`, ...), and of each session `created`, `robot`, `world`, `failure`,
    `objective`, `duration_s` and `backend`.

    Returns a `pandas.DataFrame` with `created` as times; without trials it is empty, with its usual columns.
    Raises MissingExtraError without pandas (extra `data`).
    """
    try:
        import pandas
    except ModuleNotFoundError as error:
        raise MissingExtraError("a table of sessions", "data") from error
    rows = [row for session in list_sessions(folder) for row in _rows(session)]
    table = pandas.DataFrame(rows, columns=None if rows else list(USUAL_COLUMNS))
    if rows:
        table["created"] = pandas.to_datetime(table["created"], utc=True)
    return table


def _rows(session: Session) -> list[dict[str, Any]]:
    spec = session.spec.as_json()
    about = {name: spec.get(name) for name in SPEC_COLUMNS}
    return [
        {"session": row["session"], "created": session.created, **about, **row} for row in flat_rows(session)
    ]
