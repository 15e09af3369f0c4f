"""Stored sessions of `hexctl adapt`, whole and cut off, and how they are continued."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

#: The store of before, as it lies in `runs/`.
STORE = Path(__file__).parents[1] / "data" / "sessions.sqlite"

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
    (folder / "runs").mkdir()
    shutil.copy(STORE, folder / "runs" / "sessions.sqlite")
    place_prior(folder)


def place_prior(folder: Path) -> None:
    """Put the prior that the stored sessions believe, shipped when they began, where they expect it."""
    (folder / PRIOR).parent.mkdir()
    shutil.copy(STORE.parent / Path(PRIOR).name, folder / PRIOR)


def keep(source: Path, name: str, target: Path, new_name: str, trials: int) -> None:
    """Copy a session from a store into another, under another name and as if cut off after some trials."""
    if not target.exists():
        shutil.copy(source, target)
        with closing(sqlite3.connect(target)) as store:
            for table in ("confirmations", "baselines", "trials", "sessions"):
                store.execute(f"DELETE FROM {table}")  # noqa: S608  a name of ours
            store.commit()
    with closing(sqlite3.connect(source)) as old, closing(sqlite3.connect(target)) as new:

        def copy(table: str, of: str, also: str = "", *, changed: dict[str, None] | None = None) -> None:
            cursor = old.execute(f"SELECT * FROM {table} WHERE {of} = ? {also}", (name,))  # noqa: S608
            columns = [column for column, *_ in cursor.description]
            kept = {of: new_name, **(changed or {})}
            rows = [{**dict(zip(columns, row, strict=True)), **kept} for row in cursor]
            places = ", ".join(f":{column}" for column in columns)
            new.executemany(f"INSERT INTO {table} VALUES ({places})", rows)  # noqa: S608

        ((budget,),) = old.execute("SELECT spec ->> 'budget' FROM sessions WHERE name = ?", (name,))
        whole = trials >= budget
        copy("sessions", "name", changed=None if whole else {"ended": None, "settled_on": None})
        copy("trials", "session", f"AND number <= {trials}")
        copy("baselines", "session")
        if whole:
            copy("confirmations", "session")
        new.commit()
        new.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        new.execute("PRAGMA journal_mode = DELETE")
        new.execute("VACUUM")


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
