"""The paper's study: its walks and searches, the paper's claims, and the report."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hexctl.study.experiment import Experiment, json_value, plain, records
from hexctl.study.landscape import NUMBERS, Landscape
from hexctl.study.paper.claims import claims_of, expected_best_rank
from hexctl.study.paper.evidence import EARLY, EARLY_M, LATE, LATE_M, Claim, cm
from hexctl.study.paper.searches import ALL, NULL_DRAWS, Findings, search_all
from hexctl.study.paper.study_figures import study_drawings
from hexctl.study.paper.study_plan import StudyPlan
from hexctl.study.report_page import Section, Table, reading
from hexctl.study.versions import code_versions
from hexctl.study.walking import Work

if TYPE_CHECKING:
    from pandas import DataFrame

#: Numbers of evaluations at which tables show the curves, up to the budget.
SHOWN = (1, 10, 20, 40, 60, 120)


def landscapes_of(findings: Findings) -> "DataFrame":
    """Return the landscapes of the first world in numbers, a row for each."""
    from pandas import DataFrame

    return DataFrame(
        {
            "leg": leg,
            "self_rotation": rotation,
            "gaits": len(landscape.codes),
            "valid": int(landscape.valid.sum()),
            "left_share": landscape.left_share,
            "within_0.10_m": landscape.within(EARLY_M),
            "within_0.025_m": landscape.within(LATE_M),
            "best_m": landscape.best_m,
        }
        for (world, leg, rotation), landscape in findings.landscapes.items()
        if not world
    )


def study_json(findings: Findings) -> dict[str, Any]:
    """Return settings and results of a study as JSON values; null if there is no number."""
    plan = findings.plan
    names = ("legs", "optimizers", "runs", "budget", "duration_s", "seed", "failure", "self_rotation")
    return {
        "robot": plan.robot.name,
        "world": plan.world.model_dump(mode="json"),
        **plain(plan, *names, "worlds"),
        "code": code_versions(),
        "claims": [{**asdict(claim), "verdict": claim.verdict} for claim in findings.claims],
        "landscapes": records(landscapes_of(findings)),
        "convergence": [_curve_json(findings, name) for name in plan.optimizers],
    }


def _curve_json(findings: Findings, optimizer: str) -> dict[str, Any]:
    curve = findings.curves[ALL, optimizer].loc[_shown(findings)]
    means = {
        name: {str(at): json_value(value) for at, value in curve[name].items()}
        for name in ("mean_m", "std_m", "share_of_runs")
    }
    return {"optimizer": optimizer, **means}


def _shown(findings: Findings) -> list[int]:
    return [count for count in SHOWN if count <= findings.plan.budget]


def study_tables(findings: Findings) -> "dict[str, DataFrame]":
    """Return landscapes (a row per gait), convergence (per evaluation) and runs (per run and evaluation)."""
    from pandas import concat

    head = ["leg", "optimizer"]
    curves = {key: curve for key, curve in findings.curves.items() if key[0] != ALL}
    runs = findings.first_runs[[*head, "seed", "codes", "scores", "best_m"]]
    runs = runs.rename(columns={"codes": "code", "scores": "score"})
    long = runs.assign(evaluation=[range(1, findings.plan.budget + 1)] * len(runs))
    long = long.explode(["evaluation", "code", "score", "best_m"])
    types = {"evaluation": int, "code": int, "score": float, "best_m": float}
    walked = [one for (world, *_), one in findings.landscapes.items() if not world]
    return {
        "landscapes": concat([_gaits(landscape) for landscape in walked]),
        "convergence": concat(curves, names=[*head, "evaluation"]).reset_index(),
        "runs": long[[*head, "seed", "evaluation", "code", "score", "best_m"]].astype(types),
    }


def _gaits(landscape: Landscape) -> "DataFrame":
    from pandas import DataFrame

    spec = landscape.spec
    paths = [path[np.isfinite(path[:, 0])] for path in landscape.paths_m]
    return DataFrame(
        {
            "code": landscape.codes,
            "robot": spec.robot.name,
            "leg": spec.leg,
            "failure": spec.failure,
            "self_rotation": spec.self_rotation,
            "slots": [spec.space.slots_of(code) for code in landscape.codes.tolist()],
            "status": landscape.status.tolist(),
            "final_m": landscape.final_m,
            **{name: landscape.number(name) for name in NUMBERS},
            "path_progress_m": [path[:, 0] for path in paths],
            "path_deviation_m": [path[:, 1] for path in paths],
        }
    )


def study_sections(findings: Findings) -> Iterator[Section]:
    """Return the parts of the report of a study."""
    yield Section("", [_settings(findings)])
    header = ("claim of the paper", "holds here if", "measured here", "for comparison", "verdict")
    rows = [(one.claim, one.rule, one.measured, _beside(one), one.verdict) for one in findings.claims]
    yield Section("Claims of the paper", [Table(header, rows)])
    ranks = {"early": expected_best_rank(EARLY), "late": expected_best_rank(LATE)}
    yield reading("study", draws=NULL_DRAWS, **ranks)
    yield Section("Landscapes", [_landscapes(findings)])
    yield Section("Means over all legs and runs, with standard deviation", [_means(findings)])


def _settings(findings: Findings) -> str:
    plan = findings.plan
    return (
        f"Robot {plan.robot.name}; legs {', '.join(str(leg) for leg in plan.legs)}, each {plan.failure}; all "
        f"120 gaits, {plan.duration_s:g} s each, self-rotation {' and '.join(plan.rotations)}; claims judged "
        f"over {plan.worlds} world{'s' * (plan.worlds > 1)}; then {', '.join(plan.optimizers)} with "
        f"{plan.runs} seeded runs of {plan.budget} evaluations, looked up in the landscapes with "
        f"self-rotation {plan.self_rotation}. "
        f"Seed {plan.seed}."
    )


def _beside(claim: Claim) -> str:
    null = f"random numbers: {claim.null}" if claim.null else ""
    symmetric = f"symmetry: {claim.symmetric}" if claim.symmetric else ""
    return "; ".join(text for text in (claim.beside, symmetric, null) if text)


def _landscapes(findings: Findings) -> Table:
    header = ("leg", "self-rotation", "gaits", "valid", "end left", "within 10 cm", "within 2.5 cm", "best")
    texts = {"left_share": "{:.0%}".format, "best_m": cm}
    rows = [
        [texts.get(name, str)(value) for name, value in row.items()]
        for row in landscapes_of(findings).to_dict("records")
    ]
    return Table(header, rows)


def _means(findings: Findings) -> Table:
    """A row for each optimizer, with mean, standard deviation and share of the runs at some evaluations."""

    def text(optimizer: str, after: int) -> str:
        at = findings.curves[ALL, optimizer].loc[after]
        share = "" if at["share_of_runs"] == 1 else f" [{at['share_of_runs']:.0%} of the runs]"
        return f"{cm(at['mean_m'])} ± {cm(at['std_m'])}{share}"

    cells = {f"after {after}": partial(text, after=after) for after in _shown(findings)}
    return Table.of(findings.plan.optimizers, {"optimizer": str, **cells})


@dataclass(frozen=True, kw_only=True)
class PaperStudy(StudyPlan, Experiment[Findings]):
    """The study of a plan: it walks, searches, judges the claims, and reports."""

    NAME: ClassVar[str] = "study"
    REPORT: ClassVar[str] = "report.html"
    HEADING: ClassVar[str] = "Gaits for a failed leg: the paper's experiments repeated"

    numbers = staticmethod(study_json)
    tables = staticmethod(study_tables)
    drawings = staticmethod(study_drawings)
    sections = staticmethod(study_sections)

    def find(self, work: Work) -> Findings:
        """Walk all gaits, search the landscapes and judge the claims."""
        landscapes = work.evaluate(self.specs())
        searched = [spec for spec in self.specs_by_world()[0] if spec.self_rotation == self.self_rotation]
        work.progress.stage("searches, leg by leg", len(searched))
        found = search_all(self, landscapes, work.progress.step)
        return replace(found, claims=tuple(claims_of(found)))

    def lines(self, found: Findings) -> list[str]:
        """Return the verdicts in a column before the claims, and below them each reason once."""
        pairs = [(claim.verdict.partition(": "), claim.claim) for claim in found.claims]
        lines = [f"{verdict:<15} {claim}" for (verdict, _, _), claim in pairs]
        reasons = dict.fromkeys(f"{verdict}: {reason}" for (verdict, _, reason), _ in pairs if reason)
        return [*lines, *reasons]
