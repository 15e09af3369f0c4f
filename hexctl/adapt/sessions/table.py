"""All trials of all sessions as one table."""

from pathlib import Path
from typing import Any

from hexctl.adapt.sessions.export import flat_rows
from hexctl.adapt.sessions.session import Session
from hexctl.adapt.sessions.store import RUNS, list_sessions

#: What is told of the session in each row: fields of `SessionSpec`.
SPEC_COLUMNS = ("robot", "world", "failure", "objective", "duration_s", "backend")

#: Columns that an empty table has, so that a question about it has an answer.
USUAL_COLUMNS = (
    "session",
    "created",
    *SPEC_COLUMNS,
    *("optimizer", "failed_leg", "seed", "index", "code", "slots", "score", "status", "walked_s"),
    *("distance_m", "deviation_signed_m", "energy_j", "cost_of_transport"),
)


def sessions(folder: Path | str = RUNS) -> Any:
    """All trials of all sessions of a folder, a row each, for questions across sessions.

    Columns are those of `export_session` (`session`, `optimizer`, `failed_leg`, `slots`, `score`, `status`,
    `deviation_signed_m`, ...), and of each session `created`, `robot`, `world`, `failure`, `objective`,
    `duration_s` and `backend`.

    Args:
        folder: where the sessions lie.

    Gives a `pandas.DataFrame` where pandas is installed (extra `data`), with `created` as times, else a list
    of dicts; both are empty where there are no trials, the first with its usual columns.
    """
    rows = [row for session in list_sessions(folder) for row in _rows(session)]
    try:
        import pandas
    except ModuleNotFoundError:
        return rows
    table = pandas.DataFrame(rows, columns=None if rows else list(USUAL_COLUMNS))
    if rows:
        table["created"] = pandas.to_datetime(table["created"], utc=True)
    return table


def _rows(session: Session) -> list[dict[str, Any]]:
    """Rows of a session, with what it was about in front."""
    spec = session.spec.as_json()
    about = {name: spec.get(name) for name in SPEC_COLUMNS}
    return [
        {"session": row["session"], "created": session.created, **about, **row} for row in flat_rows(session)
    ]
