"""The report of a study: one HTML page that needs no other file, with figures and tables next to it."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from hexctl.study.reports.report_page import Block, Bullets, Fold, Picture, Section, Table
from hexctl.study.reports.study_summary import summary
from hexctl.study.reports.study_tables import SHOWN
from hexctl.study.searches import NULL_DRAWS, Curve, Findings
from hexctl.study.verdicts.assumptions import HEADER, assumption_rows
from hexctl.study.verdicts.claim_evidence import Claim, cm, limit_text
from hexctl.study.verdicts.claims import expected_best_rank
from hexctl.study.verdicts.distance_criterion import LATE_ABOVE_BEST_M, BarRow, bar_rows
from hexctl.study.verdicts.trajectories import EARLY, EARLY_M, LATE, LATE_M, left_share, within

READING = (
    "A claim holds, does not hold, or there is no evidence: the numbers decide nothing, a symmetry implies "
    "it, or it holds on random numbers, too. Each of the three is a result.",
    'Where the paper gives a number, "about" is that number plus or minus half of it, on both sides: a mean '
    "far below it is not what the paper reports either, and the table says which side is missed.",
    "Legs that a symmetry of the robot turns into one another are one experiment and have one vote. "
    "Intervals are 95 % intervals of the mean over worlds that differ in what the paper leaves open "
    "(friction, stiffness of the servos, contact time); with one world there is none.",
    "Random numbers: the scores of each landscape dealt out at random over the codes, "
    f"{NULL_DRAWS} times. A claim about searches that holds there, too, says nothing about the encoding or "
    "the search.",
    "Final deviation (the paper's F) counts, of valid trials only: a robot that fell, or made less than half "
    "of the ideal distance, is behind every other, however near to the line it stands.",
    "A run that has found no valid gait yet has no best-so-far. It is left out of means and percentiles; the "
    "share of the runs that are in them is in convergence.parquet, and in the tables where it is not all.",
    "Two counts of evaluations: the paper's, where a repeated code costs one, and hexctl's, where each gait "
    "is paid for once. The paper's claims are judged by the paper's count, the bar is shown by both.",
    "Searches with a population on the one line of codes converge and then ask for nothing new. By the fresh "
    "count random untried codes follow, so what a long curve gains later is the random search's "
    "work.",
    "The random baseline is strong: the best of n gaits drawn from 120 without repetition has the expected "
    f"rank 121/(n + 1), which is {expected_best_rank(EARLY):.1f} after {EARLY} and "
    f"{expected_best_rank(LATE):.1f} after {LATE}.",
    "dps is a reconstruction from published parents: the equations of the original are not open to us.",
    "No parameter was tuned on these landscapes. Simulator, floor friction and servos are not the paper's, "
    "which does not give them; directions and orders of magnitude compare, single numbers do not.",
)


DEFAULT_GAITS = (
    "The gaits that the robot would use anyway, its default one and the tripod, walked with the same failed "
    "leg, self-rotation and world. They are no part of the landscapes: the tripod has no code. Where one of "
    "them ends nearer to the line than a search, the search was not needed. A tripod that is its own mirror "
    "image about the trailing leg ends near the line on a robot and in a world that are symmetric, too, and "
    "in no other. Searches: the median of the runs and, in brackets, the best one, each gait paid for once."
)


def study_sections(findings: Findings, pictures: Mapping[str, Picture]) -> Iterator[Section]:
    """Return the parts of the report of a study."""
    parameters = Fold("Parameters of the world", _parameters(findings))
    sentence = findings.uncertainty.sentence
    yield Section("", [summary(findings), _settings(findings), sentence, parameters])
    yield Section("Claims of the paper", [_claims(findings.claims)])
    yield Section("How to read this", [Bullets([*READING, _stuck(findings)])])
    left_open = (
        "What the paper leaves open, and how it is read here; numbers are those of ant on the flat "
        "floor, leg locked, after the turn."
    )
    yield Section("Assumptions", [left_open, Table(HEADER, assumption_rows())])
    yield Section("The bar: mean over legs and runs", _bar_blocks(findings))
    if findings.default_walks:
        yield Section("Without a search", [DEFAULT_GAITS, _defaults(findings)])
    for name, picture in pictures.items():
        yield Section(name.replace("_", " ").capitalize(), [picture])
    yield from _numbers(findings)


def _bar_blocks(findings: Findings) -> list[Block]:
    late = limit_text(LATE_M)
    bar = (
        f"{limit_text(EARLY_M)} within {EARLY} evaluations; within {LATE}, {late}, or, for a leg whose best "
        f"gait of all is above {late}, {limit_text(LATE_ABOVE_BEST_M)} more than that gait. Beside it the "
        "random baseline, which has to hold it too."
    )
    fresh, paper = (_bars(findings, paper_count=count) for count in (False, True))
    return [bar, "Each gait paid for once:", fresh, "By the paper's count:", paper]


def _numbers(findings: Findings) -> Iterator[Section]:
    yield Section("Landscapes", [_landscapes(findings)])
    yield Section("Means over all legs and runs, with standard deviation", [_means(findings)])
    title = "Means of each leg over its runs, with standard deviation, by the paper's count"
    yield Section(title, [_leg_means(findings)])
    distinct = (
        "Mean over runs: codes of its own until the search is stuck / different codes that the paper's "
        "count buys."
    )
    yield Section("Distinct codes", [distinct, _distinct(findings)])


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


def _parameters(findings: Findings) -> Table:
    """The simulated world, by the names of its file."""
    world = findings.plan.world.model_dump()
    rows = [(name, str(value)) for name, value in world.items() if name != "sensor_noise"]
    return Table(("parameter", "value"), rows)


def _stuck(findings: Findings) -> str:
    """After how many codes the searches of this study were stuck."""
    means = {
        name: [float(findings.searches[leg, name, True].own_codes.mean()) for leg in findings.searched]
        for name in findings.heuristics
    }
    each = ", ".join(f"{name} after {min(of):.0f} to {max(of):.0f}" for name, of in means.items())
    return (
        f"Distinct codes until a search is stuck, means of the runs of each leg: {each or 'none searched'}."
    )


def _claims(claims: Iterable[Claim]) -> Table:
    rows = [(claim.claim, claim.rule, claim.measured, _beside(claim), claim.verdict) for claim in claims]
    return Table(("claim of the paper", "holds here if", "measured here", "beside it", "verdict"), rows)


def _beside(claim: Claim) -> str:
    """What a claim is compared with: the baseline, symmetries, random numbers."""
    null = f"random numbers: {claim.null}" if claim.null else ""
    symmetric = f"symmetry: {claim.symmetric}" if claim.symmetric else ""
    return "; ".join(text for text in (claim.beside, symmetric, null) if text)


def _bars(findings: Findings, *, paper_count: bool) -> Table:
    legs = [f"leg {leg}" for leg in findings.searched]
    rows = bar_rows(findings, paper_count=paper_count)
    header = ("optimizer", "evaluations", "bar", "mean", "verdict", *legs)
    return Table(header, list(_bar_lines(rows, len(legs))))


def _bar_lines(rows: list[BarRow], legs: int) -> Iterator[list[str]]:
    """One row of cells per optimizer and bar: all legs together, then each."""
    for first in range(0, len(rows), legs + 1):
        together, *each = rows[first : first + legs + 1]
        mean = cm(together.mean_m) + _share(together.share)
        head = [together.optimizer, str(together.evaluations), cm(together.limit_m), mean]
        yield [*head, together.verdict] + [_leg_cell(row) for row in each]


def _leg_cell(row: BarRow) -> str:
    over = f" (+{cm(row.over_m)})" if row.holds is False else ""
    return cm(row.mean_m) + over + _share(row.share)


def _share(share: float) -> str:
    return "" if share == 1 else f" [{share:.0%} of the runs]"


def _landscapes(findings: Findings) -> Table:
    header = ("leg", "self-rotation", "gaits", "valid", "end left", "within 10 cm", "within 2.5 cm", "best")
    rows = [
        (
            str(landscape.spec.leg),
            landscape.spec.self_rotation,
            str(len(landscape.codes)),
            str(int(landscape.valid.sum())),
            f"{left_share(landscape):.0%}",
            str(within(landscape, EARLY_M)),
            str(within(landscape, LATE_M)),
            findings.uncertainty.beside(landscape.best_m),
        )
        for landscape in findings.landscapes.values()
    ]
    return Table(header, rows)


def _defaults(findings: Findings) -> Table:
    """The robot's own gaits beside the landscape and the searches of each leg."""
    names = list(dict.fromkeys(walk.gait for walk in findings.default_walks))
    after = min(EARLY, findings.plan.budget)
    searches = [f"{name} after {after}" for name in findings.plan.optimizers]
    header = ("leg", *names, "median of all valid gaits", "best of all gaits", *searches)
    return Table(header, [_default_row(findings, leg, after) for leg in findings.searched])


def _default_row(findings: Findings, leg: int, after: int) -> list[str]:
    landscape = findings.rotated(leg)
    valid_m = landscape.final_m[landscape.valid]
    cells = [walk.status if walk.final_m is None else cm(walk.final_m) for walk in findings.defaults(leg)]
    median_m = float(np.median(valid_m)) if valid_m.size else float("nan")
    cells += [cm(median_m), cm(landscape.best_m)]
    for name in findings.plan.optimizers:
        search = findings.searches[leg, name, False]
        found_m = search.best_m[:, after - 1]
        best_m = float(np.nanmin(found_m)) if np.isfinite(found_m).any() else float("nan")
        cells.append(f"{cm(search.curve.median[after - 1])} ({cm(best_m)})")
    return [str(leg), *cells]


def _means(findings: Findings) -> Table:
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    rows = []
    for paper_count in (False, True):
        for name in findings.plan.optimizers:
            curve = findings.mean_curve(name, paper_count=paper_count)
            rows.append([name, "paper's" if paper_count else "fresh", *_curve_cells(curve, shown)])
    return Table(("optimizer", "count", *[f"after {count}" for count in shown]), rows)


def _leg_means(findings: Findings) -> Table:
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    rows = [
        [str(leg), name, *_curve_cells(findings.searches[leg, name, True].curve, shown)]
        for leg in findings.searched
        for name in findings.plan.optimizers
    ]
    return Table(("leg", "optimizer", *[f"after {count}" for count in shown]), rows)


def _curve_cells(curve: Curve, shown: list[int]) -> list[str]:
    return [
        f"{cm(curve.mean[at - 1])} ± {cm(curve.std[at - 1])}{_share(curve.share[at - 1])}" for at in shown
    ]


def _distinct(findings: Findings) -> Table:
    """Codes that each search asks for by itself, and those that the paper's count pays for."""
    rows = []
    for name in findings.plan.optimizers:
        searches = [findings.searches[leg, name, True] for leg in findings.searched]
        cells = [f"{search.own_codes.mean():.0f} / {search.distinct.mean():.0f}" for search in searches]
        rows.append([name, *cells])
    legs = [f"leg {leg}" for leg in findings.searched]
    return Table(("optimizer", *legs), rows)
