"""Code that a session names is imported only when somebody vouches for it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.adaptation import Adaptation
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.code_trust import check_trusted
from hexctl.adapt.sessions.store import SessionStore, load_session
from hexctl.errors import InputError


@pytest.mark.parametrize("field", ["optimizer", "objective", "backend", "policy"])
def test_a_session_imports_no_code_without_trust(field: str) -> None:
    spec = new_spec(failed_leg=5)
    check_trusted(spec, (), trust=False)
    named: dict[str, Any] = {field: "planted:Thing"}
    foreign = replace(spec, **named)
    with pytest.raises(InputError, match="trust"):
        check_trusted(foreign, (), trust=False)
    check_trusted(foreign, (), trust=True)
    check_trusted(foreign, {"servos" if field == "backend" else field}, trust=False)


def test_resuming_a_foreign_session_runs_none_of_its_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "planted_score.py").write_text("open('ran', 'w').close()\ndef score(result): return 1.0\n")
    foreign = replace(new_spec(failed_leg=5, budget=2), objective="planted_score:score")
    store = SessionStore(tmp_path / "runs")
    name = store.create(foreign).name
    for session in (name, load_session(name, tmp_path / "runs")):
        with pytest.raises(InputError, match="trust"):
            Adaptation.resume(session, folder=tmp_path / "runs", record=False)
    assert not (tmp_path / "ran").exists()
    Adaptation.resume(name, folder=tmp_path / "runs", record=False, trust=True)
    assert (tmp_path / "ran").exists()
