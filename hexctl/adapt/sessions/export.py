"""The trials of a session as a table, in a CSV or Parquet file."""

import csv
from pathlib import Path
from typing import Any

from hexctl.adapt.sessions.session import BASELINE_GAITS, Session
from hexctl.control.result import QUALITIES
from hexctl.errors import InputError, MissingExtraError

#: What was predicted for a trial, a column each.
EXPECTED = ("signed_m", "low_m", "high_m", "chance")

FORMATS = (".csv", ".parquet")


#: Columns that were added before those of the baseline, and after them, in the order in which they came.
LATER_COLUMNS = ("cause",)
LAST_COLUMNS = (
    "hold",
    *QUALITIES,
    "trim_deg",
    "wanted_trim_deg",
    "turn_trim_deg_s",
    "wanted_turn_trim_deg_s",
)


def flat_rows(session: Session) -> list[dict[str, Any]]:
    """Rows, one per trial; empty for a session without trials.

    The baseline is in columns of its own, the same in every row: a row of its own would be taken for a trial.
    """
    rows = []
    baseline = _baseline_columns(session)
    for trial in session.trials:
        values = trial.as_json()
        deviation = values.pop("deviation_m")
        expected = values.pop("expected") or {}
        values |= {f"expected_{name}": expected.get(name) for name in EXPECTED}
        values["slots"] = " ".join(str(slot) for slot in trial.slots)
        values |= {f"deviation_{name}_m": value for name, value in deviation.items()}
        spec = session.spec
        head = {"session": session.name, "optimizer": spec.optimizer, "failed_leg": spec.failed_leg}
        # Columns that came later stay behind those of before.
        later, last = ({name: values.pop(name) for name in names} for names in (LATER_COLUMNS, LAST_COLUMNS))
        rows.append({**head, "seed": spec.seed, **values, **later, **baseline, **last})
    return rows


def _baseline_columns(session: Session) -> dict[str, Any]:
    """Four columns for each gait of a baseline, None where it was not walked; the newest gait comes last."""
    walked = {walk.gait: walk.as_json() for walk in session.baseline}
    columns: dict[str, Any] = {}
    for gait in dict.fromkeys((*BASELINE_GAITS[1:], *BASELINE_GAITS, *walked)):
        walk = walked.get(gait, {})
        columns[f"baseline_{gait}_score"] = walk.get("score")
        columns[f"baseline_{gait}_deviation_m"] = walk.get("deviation_m", {}).get("signed")
        columns[f"baseline_{gait}_distance_m"] = walk.get("distance_m")
        columns[f"baseline_{gait}_status"] = walk.get("status")
    return columns


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
