"""Which cells are run, which are not and why, and how a run goes on."""

from pathlib import Path

import pytest

from faults.backend import BACKENDS
from faults.fault import FAULTS
from faults.matrix import Matrix, jobs
from faults.measurement import Outcome
from faults.phase import PHASES
from faults.results import Results
from faults.sense import cells, left_out, why_not
from faults.table import HOLDS, UNMEASURED, bars
from tests.faults.outcomes import outcome


def test_every_combination_is_run_or_has_a_reason() -> None:
    run = set(cells())
    for fault in FAULTS.values():
        for backend in BACKENDS.values():
            for phase in PHASES:
                named = why_not(fault, backend, phase)
                assert ((fault.name, backend.name, phase) in run) == (named is None)
    assert len(run) > 500
    assert all(what and reason for reason, what in left_out().items())


def test_a_run_goes_on_where_it_was(tmp_path: Path) -> None:
    only = ["none/zenoh/walking"]
    assert [job.wanted for job in jobs(only, 2, [])] == [(("walking", 0), ("walking", 1))]
    results = Results(tmp_path / "results.jsonl")
    results.add(outcome())
    with (tmp_path / "results.jsonl").open("a") as file:
        file.write('{"fault": "none", "backe')  # a run that was killed
    assert [job.wanted for job in jobs(only, 2, results.read())] == [(("walking", 1),)]


def test_an_error_of_one_injection_ends_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise OSError("no space")

    monkeypatch.setattr("faults.matrix.Rig", fails)
    said: list[Outcome | str] = []
    work = jobs(["none/zenoh/walking", "none/mavlink/walking"], 2, [])
    matrix = Matrix(Results(tmp_path / "results.jsonl"), said.append)
    matrix.run(work, rigs=1)
    assert matrix.broken == 4
    names = [
        f"none/{backend}/walking {number}: Traceback" for backend in ("zenoh", "mavlink") for number in (0, 1)
    ]
    assert [str(each)[: len(name)] for each, name in zip(said, names, strict=True)] == names
    assert all("OSError: no space" in str(each) for each in said)


def test_a_share_holds_only_with_as_many_injections_as_show_it() -> None:
    good = outcome(fault="controller-killed", rest_s=0.04, stops=("expired",), goes_on=False)
    name = "at rest within 0.25 s in 99.9 % of the injections"
    assert bars([])[name] == UNMEASURED
    assert bars([good] * 100)[name] == "not shown yet (100 of 100; more than 97.05 % with 95 % confidence)"
    assert bars([good] * 2994)[name].startswith("not shown yet (2994 of 2994")
    assert bars([good] * 2996)[name].startswith(f"{HOLDS} (2996 of 2996")


def test_a_line_behind_one_that_was_cut_off_is_kept_and_one_of_another_version_is_named(
    tmp_path: Path,
) -> None:
    path = tmp_path / "results.jsonl"
    path.write_text('{"fault": "none", "backe', encoding="utf-8")
    results = Results(path)
    results.add(outcome())
    assert results.read() == [outcome()]
    with path.open("a") as file:
        file.write('{"flavour": 1}\n')
    with pytest.raises(ValueError, match=r"results.jsonl, line 3: .*flavour"):
        results.read()
