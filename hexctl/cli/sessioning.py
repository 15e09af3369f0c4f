"""What `hexctl sessions` does."""

import json
import shutil
from pathlib import Path
from typing import Any

import typer

from hexctl.adapt.session import Session
from hexctl.adapt.store import SessionStore, export
from hexctl.cli.console import RUNS, print_result
from hexctl.cli.table import end_of, session_lines, subject
from hexctl.errors import InputError


def list_all(*, as_json: bool) -> None:
    """Print every session, newest last: name, what it searched, how far it came."""
    loaded = _all_sessions()
    if as_json:
        print_result(json.dumps([_brief(session) for session in loaded]))
    elif not loaded:
        print_result(f"no sessions under {RUNS}/ yet; hexctl adapt makes one")
    else:
        print_result("\n".join(_line(session) for session in loaded))


def show_one(name: str, *, as_json: bool) -> None:
    """Print a session with all its trials."""
    with _open_store(name) as store:
        session = store.load(name)
    print_result(json.dumps(session.as_json()) if as_json else "\n".join(session_lines(session)))


def export_one(name: str, path: Path) -> None:
    """Write a session's trials to a file."""
    with _open_store(name) as store:
        export(store.load(name), path)
    print_result(f"{path}")


def delete_one(name: str, *, yes: bool) -> None:
    """Delete a session and its recordings, asking first."""
    with _open_store(name) as store:
        trials = len(store.load(name).trials)
        if not yes and not _agreed(f"delete session {name}, its {trials} trials and their recordings?"):
            print_result("nothing deleted")
            return
        with store.held(name):
            store.delete(name)
            shutil.rmtree(store.folder_of(name), ignore_errors=True)
    print_result(f"deleted {name}")


def _agreed(question: str) -> bool:
    """Ask; raises InputError where nobody can answer."""
    try:
        return typer.confirm(question)
    except typer.Abort:
        raise InputError("sessions delete: got no answer; allowed: y or n, or --yes to go without") from None


def _open_store(name: str) -> SessionStore:
    """Return the store, without making one where there is none."""
    if not (RUNS / "sessions.sqlite").is_file():
        raise InputError(f"session: got {name!r}; allowed: none yet, hexctl adapt makes one under {RUNS}/")
    return SessionStore(RUNS)


def _all_sessions() -> list[Session]:
    if not (RUNS / "sessions.sqlite").is_file():
        return []
    with SessionStore(RUNS) as store:
        return [store.load(name) for name in store.names()]


def _brief(session: Session) -> dict[str, Any]:
    values = session.as_json()
    return {**values, "trials": len(session.trials)}


def _line(session: Session) -> str:
    spec, best = session.spec, session.best
    outcome = f"best {spec.score_text(best.score)} (code {best.code})" if best else "no valid trial"
    return (
        f"{session.name}  {subject(spec)}, {spec.optimizer}, {len(session.trials)} of {spec.budget} trials "
        f"of {spec.duration_s:g} s, {outcome}; {end_of(session)}"
    )
