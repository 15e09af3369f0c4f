"""The paper's experiments, the benchmarks of transfer, holds and recovery as library calls."""

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hexctl.backends.sim.world import World
from hexctl.errors import InputError, argument, check_type
from hexctl.study.default_gaits import walk_default_gaits
from hexctl.study.holds.hold_findings import HoldFindings, hold_bars
from hexctl.study.holds.hold_plan import HoldPlan
from hexctl.study.holds.hold_report import REPORT as HOLD_REPORT
from hexctl.study.holds.hold_report import holds_json, holds_lines, write_hold_report
from hexctl.study.holds.hold_walks import HoldCache, walk_all
from hexctl.study.landscapes.cache import LandscapeCache
from hexctl.study.landscapes.evaluate import Progress, Silent, check_jobs, evaluate
from hexctl.study.recovery.recovery_criteria import recovery_bars
from hexctl.study.recovery.recovery_findings import RecoveryFindings
from hexctl.study.recovery.recovery_plan import RecoveryPlan
from hexctl.study.recovery.recovery_report import REPORT as RECOVERY_REPORT
from hexctl.study.recovery.recovery_report import recovery_json, recovery_lines, write_recovery_report
from hexctl.study.recovery.recovery_walks import EpisodeCache
from hexctl.study.recovery.recovery_walks import walk_all as walk_episodes
from hexctl.study.reports.figure_style import check_drawing
from hexctl.study.reports.figures import FIGURES
from hexctl.study.reports.report import REPORT, write_report
from hexctl.study.reports.study_tables import summary_json
from hexctl.study.searches import Findings, search_all
from hexctl.study.study_plan import StudyPlan
from hexctl.study.transfer.transfer_plan import TransferPlan
from hexctl.study.transfer.transfer_report import REPORT as TRANSFER_REPORT
from hexctl.study.transfer.transfer_report import transfer_bars, transfer_json, write_transfer_report
from hexctl.study.transfer.transfer_searches import TransferFindings, search_worlds
from hexctl.study.verdicts.claim_evidence import Claim
from hexctl.study.verdicts.claims import claims_of
from hexctl.study.verdicts.verdict_lines import bar_lines, missed_lines, verdict_lines
from hexctl.study.verdicts.verdict_uncertainty import StudyUncertainty


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportResult(ABC):
    """Result of what ends in a report.

    Attributes:
        report: the HTML page; tables and figures are files beside it.
        notes: remarks on files of the cache that could not be used.
    """

    report: Path
    notes: tuple[str, ...]

    @abstractmethod
    def numbers(self) -> dict[str, Any]:
        """What was found, as plain JSON values."""

    @abstractmethod
    def lines(self) -> list[str]:
        """Tables and verdicts, as lines of text."""

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values, as in the file beside the report and printed by `--json`."""
        return {
            "out": str(self.report.parent),
            "report": str(self.report),
            **self.numbers(),
            "notes": list(self.notes),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class StudyResult(ReportResult):
    """A finished study.

    Attributes:
        findings: landscapes and searches.
        claims: the paper's claims, judged by them.
        uncertainty: the simulation's own, of the walks.
        times_s: wall time of the parts `landscapes`, `searches` and `report`.
    """

    findings: Findings
    claims: tuple[Claim, ...]
    uncertainty: StudyUncertainty
    times_s: dict[str, float]

    def numbers(self) -> dict[str, Any]:
        """Landscapes, searches and claims, as plain JSON values."""
        return {**summary_json(self.findings, self.claims, self.uncertainty), "times_s": self.times_s}

    def lines(self) -> list[str]:
        """Claims, bars that are missed, and the time spent, as lines of text."""
        claims = verdict_lines((claim.verdict, claim.claim) for claim in self.claims)
        spent = ", ".join(f"{name} {spent_s:.0f} s" for name, spent_s in self.times_s.items())
        return [*claims, *missed_lines(self.findings), *self.uncertainty.lines, spent]


@dataclass(frozen=True, kw_only=True, eq=False)
class TransferResult(ReportResult):
    """A finished transfer benchmark.

    Attributes:
        findings: landscapes of unseen worlds and the searches in them.
        uncertainty: the simulation's own, of the walks.
    """

    findings: TransferFindings
    uncertainty: StudyUncertainty

    def numbers(self) -> dict[str, Any]:
        """Landscapes and searches, as plain JSON values."""
        return transfer_json(self.findings, self.uncertainty)

    def lines(self) -> list[str]:
        """Verdicts, as lines of text."""
        return bar_lines(transfer_bars(self.findings))


@dataclass(frozen=True, kw_only=True, eq=False)
class HoldResult(ReportResult):
    """A finished comparison of holds.

    Attributes:
        findings: walks in unseen worlds, open loop and with holds.
    """

    findings: HoldFindings

    def numbers(self) -> dict[str, Any]:
        """Walks and verdicts, as plain JSON values."""
        return holds_json(self.findings)

    def lines(self) -> list[str]:
        """Table and verdicts, as lines of text."""
        return [*holds_lines(self.findings), *bar_lines(hold_bars(self.findings))]


@dataclass(frozen=True, kw_only=True, eq=False)
class RecoveryResult(ReportResult):
    """A finished recovery benchmark.

    Attributes:
        findings: walks in which legs fail.
    """

    findings: RecoveryFindings

    def numbers(self) -> dict[str, Any]:
        """Walks and verdicts, as plain JSON values."""
        return recovery_json(self.findings)

    def lines(self) -> list[str]:
        """Tables and verdicts, as lines of text."""
        return [*recovery_lines(self.findings), *bar_lines(recovery_bars(self.findings))]


def run_study(
    plan: StudyPlan,
    *,
    folder: Path,
    cache: LandscapeCache | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """Simulate all gaits of a plan, search the landscapes, write report, figures, tables and `study.json`.

    The robot's own gaits are walked beside them, on this computer. Simulated gaits are saved while this runs:
    a call that was interrupted is continued by the next one.

    Args:
        plan: the experiments.
        folder: for the report: new, empty, or with an earlier study, which is replaced.
        cache: of landscapes; None is the one of the command line, `runs/study-cache`. Measurements of the
            simulation's uncertainty are read from the folder around it.
        jobs: threads per batch of gaits; None is all cores here, one on a Dask worker.
        dask: address of a Dask scheduler whose workers simulate; None simulates here.
        progress: observer.

    Raises InputError for a plan, a folder or an address that cannot be used, MissingExtraError without
    Matplotlib or PyArrow, CacheError when landscapes cannot be saved; all but the last before anything runs.
    """
    check_type(plan, StudyPlan, "plan", "a StudyPlan")
    folder, cache, progress = Path(folder), cache or LandscapeCache(), progress or Silent()
    check_jobs(jobs)
    check_drawing()
    plan.check()
    with report_folder(folder, REPORT):
        cache.probe()
        uncertainty = _uncertainty_of(plan, plan.world, cache)
        times_s = _Stopwatch()
        landscapes = evaluate(plan.specs(), cache, jobs=jobs, dask=dask, progress=progress)
        progress.stage("the robot's own gaits", len(plan.legs))
        default_walks = walk_default_gaits(plan, cache, jobs=jobs, on_leg=progress.step)
        times_s.lap("landscapes")
        progress.stage("searches, leg by leg", len(plan.searched_specs()))
        findings = search_all(plan, landscapes, lambda _: progress.step())
        findings = replace(findings, default_walks=default_walks)
        claims = tuple(claims_of(findings))
        times_s.lap("searches")
        progress.stage("figures", len(FIGURES))
        report = write_report(findings, claims, uncertainty, folder, lambda _: progress.step())
        times_s.lap("report")
        result = StudyResult(
            findings=findings,
            claims=claims,
            uncertainty=uncertainty,
            report=report,
            notes=tuple(cache.notes),
            times_s=times_s.laps,
        )
        _write_json(result.to_json(), folder / "study.json")
    return result


def run_transfer(
    plan: TransferPlan,
    *,
    folder: Path,
    cache: LandscapeCache | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
) -> TransferResult:
    """Simulate all gaits in unseen worlds, search them, write report, figures, table and `transfer.json`.

    Arguments and errors are those of `run_study`; RobotFaultError when no gait is valid in any world.
    """
    cache, progress = cache or LandscapeCache(), progress or Silent()
    check_jobs(jobs)
    check_drawing()
    plan.check()
    with report_folder(folder, TRANSFER_REPORT):
        cache.probe()
        uncertainty = _uncertainty_of(plan, plan.specs()[0].world, cache)
        landscapes = evaluate(plan.specs(), cache, jobs=jobs, dask=dask, progress=progress)
        progress.stage("searches, world by world", len(landscapes))
        findings = search_worlds(plan, landscapes, lambda _: progress.step())
        report = write_transfer_report(findings, uncertainty, folder)
        result = TransferResult(
            findings=findings, uncertainty=uncertainty, report=report, notes=tuple(cache.notes)
        )
        _write_json(result.to_json(), folder / "transfer.json")
    return result


def run_holds(
    plan: HoldPlan,
    *,
    folder: Path,
    cache: LandscapeCache | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> HoldResult:
    """Walk in unseen worlds open loop and with holds, write report, figures, table and `holds.json`.

    Arguments and errors are those of `run_study`; `jobs` is the number of legs that walk in parallel. Walks
    are saved while this runs: a call that was interrupted is continued by the next one.
    """
    check_type(plan, HoldPlan, "plan", "a HoldPlan")
    folder, cache, progress = Path(folder), cache or LandscapeCache(), progress or Silent()
    check_jobs(jobs)
    check_drawing()
    plan.check()
    with report_folder(folder, HOLD_REPORT):
        cache.probe()
        walks = walk_all(plan, HoldCache(cache), progress, jobs)
        findings = HoldFindings(plan=plan, walks=walks)
        report = write_hold_report(findings, folder)
        result = HoldResult(findings=findings, report=report, notes=tuple(cache.notes))
        _write_json(result.to_json(), folder / "holds.json")
    return result


def run_recovery(
    plan: RecoveryPlan,
    *,
    folder: Path,
    cache: LandscapeCache | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> RecoveryResult:
    """Let legs fail in mid-walk, write report, figure, table and `recovery.json`.

    Arguments and errors are those of `run_study`; `jobs` is the number of batches that walk in parallel.
    Walks are saved while this runs: a call that was interrupted is continued by the next one.
    """
    check_type(plan, RecoveryPlan, "plan", "a RecoveryPlan")
    folder, cache, progress = Path(folder), cache or LandscapeCache(), progress or Silent()
    check_jobs(jobs)
    check_drawing()
    plan.check()
    with report_folder(folder, RECOVERY_REPORT):
        cache.probe()
        episodes = walk_episodes(plan.walked(), EpisodeCache(cache), progress, jobs)
        findings = RecoveryFindings(plan=plan, episodes=episodes)
        report = write_recovery_report(findings, folder)
        result = RecoveryResult(findings=findings, report=report, notes=tuple(cache.notes))
        _write_json(result.to_json(), folder / "recovery.json")
    return result


def _uncertainty_of(plan: StudyPlan | TransferPlan, world: World, cache: LandscapeCache) -> StudyUncertainty:
    """Uncertainty of the walks of a plan, as measured in the folder around the cache or shipped."""
    return StudyUncertainty.of(plan.robot, world, plan.duration_s, cache.folder.parent, failure=plan.failure)


class _Stopwatch:
    """Wall times of consecutive parts of the work, in s, by name in `laps`."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._began_s = time.perf_counter()

    def lap(self, name: str) -> None:
        """End a part and begin the next one."""
        now_s = time.perf_counter()
        self.laps[name] = round(now_s - self._began_s, 2)
        self._began_s = now_s


@contextmanager
def report_folder(folder: Path, report: str) -> Iterator[None]:
    """Create the folder of a report; remove it at the end when nothing was written into it.

    Raises InputError unless it is new, empty, or has an earlier report of the same kind.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".probe").touch()
        (folder / ".probe").unlink()
        others = any(folder.iterdir()) and not (folder / report).exists()
    except OSError as error:
        raise InputError(
            f"{argument('out')}: {folder} cannot be used ({error.strerror}); allowed: a folder"
        ) from error
    if others:
        raise InputError(f"{argument('out')}: {folder} holds other things; allowed: a new or empty folder")
    try:
        yield
    finally:
        with suppress(OSError):
            folder.rmdir()


def _write_json(values: dict[str, Any], path: Path) -> None:
    path.write_text(json.dumps(values, indent=1), encoding="utf-8")
