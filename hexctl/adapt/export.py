"""The trials of a session as a flat table, for CSV and Parquet."""

import csv
from pathlib import Path
from typing import Any

from hexctl.adapt.session import Session
from hexctl.errors import InputError, MissingExtraError

#: What was expected of a trial, a column each.
EXPECTED = ("signed_m", "low_m", "high_m", "chance")

FORMATS = (".csv", ".parquet")


def flat_rows(session: Session) -> list[dict[str, Any]]:
    """Return one flat row per trial; empty for a session without trials."""
    rows = []
    for trial in session.trials:
        values = trial.as_json()
        deviation = values.pop("deviation_m")
        expected = values.pop("expected") or {}
        values |= {f"expected_{name}": expected.get(name) for name in EXPECTED}
        values["slots"] = " ".join(str(slot) for slot in trial.slots)
        values |= {f"deviation_{name}_m": value for name, value in deviation.items()}
        spec = session.spec
        head = {"session": session.name, "optimizer": spec.optimizer, "failed_leg": spec.failed_leg}
        rows.append({**head, "seed": spec.seed, **values})
    return rows


def export(session: Session, path: Path) -> None:
    """Write a session's trials to a new .csv or .parquet file.

    Raises InputError for another ending, a file that exists or cannot be written, or a session without
    trials.
    """
    if path.suffix not in FORMATS:
        raise InputError(f"export: got {path.name}; allowed: a name that ends in {' or '.join(FORMATS)}")
    if not session.trials:
        raise InputError(f"session {session.name}: has no trials to export")
    try:
        with path.open("xb"):
            pass
        (_write_csv if path.suffix == ".csv" else _write_parquet)(flat_rows(session), path)
    except FileExistsError:
        raise InputError(f"export: {path} exists; allowed: a new file, nothing is replaced") from None
    except OSError as error:
        raise InputError(
            f"export: {path} cannot be written ({error.strerror}); allowed: a new file"
        ) from error


def _write_csv(rows: list[dict[str, Any]], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _write_parquet(rows: list[dict[str, Any]], path: Path) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError as error:
        path.unlink()
        raise MissingExtraError("Parquet export", "study") from error
    pq.write_table(pa.Table.from_pylist(rows), path)
