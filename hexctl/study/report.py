"""The report of a study: one page that needs nothing else, with figures and tables in files beside it."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from hexctl.files import atomic_write
from hexctl.study.claims import BarRow, bar_rows, claims_of, cm, expected_best_rank, left_share, within
from hexctl.study.figures import FigureEntry, draw_figures
from hexctl.study.html import bullets, figure, heading, page, paragraph, table
from hexctl.study.landscape import Landscape
from hexctl.study.searches import Curve, Findings
from hexctl.study.tables import SHOWN, TABLES, write_tables
from hexctl.study.versions import code_versions

REPORT = "report.html"

READING = (
    "Final deviation (the paper's F) counts, of valid trials only: a robot that fell, or made less than half "
    "of the ideal distance, is behind every other, however near to the line it stands.",
    "A run that has found no valid gait yet has no best-so-far. It is left out of means and percentiles; the "
    "share of the runs that are in them is in convergence.parquet, and in the tables where it is not all.",
    "Two counts of evaluations: the paper's, where a repeated code costs one, and hexctl's, where each gait "
    "is paid for once. The paper's claims are judged by the paper's count, the bar is shown by both.",
    "Searches with a population on the one line of codes converge and then ask for nothing new. By the fresh "
    "count random untried codes go on from there, so what a long curve gains later is the random search's "
    "work.",
    "The random baseline is strong: the best of n gaits drawn from 120 without repetition has the expected "
    f"rank 121/(n + 1), which is {expected_best_rank(20):.1f} after 20 and {expected_best_rank(60):.1f} "
    "after 60.",
    "dps is a reconstruction from published parents: the equations of the original are not open to us.",
    "No parameter was tuned on these landscapes. Simulator, floor friction and servos are not the paper's, "
    "which does not give them; directions and orders of magnitude compare, single numbers do not.",
)


def write_report(findings: Findings, folder: Path, on_figure: Callable[[str], None] = lambda _: None) -> Path:
    """Write tables, figures and at last the report into a folder, and return the report's path."""
    write_tables(findings, folder)
    drawn = draw_figures(findings, folder, on_figure)
    path = folder / REPORT
    atomic_write(path, page("hexctl study", _parts(findings, drawn, folder)))
    return path


def _parts(findings: Findings, drawn: list[FigureEntry], folder: Path) -> Iterator[str]:
    yield heading("Gaits for a failed leg: the paper's experiments repeated", 1)
    yield paragraph(_settings(findings))
    yield heading("Claims of the paper")
    yield _claims(findings)
    yield heading("How to read this")
    yield bullets([*READING, _stuck(findings)])
    yield heading("The bar: mean over legs and runs")
    yield paragraph(
        "10 cm within 20 evaluations; within 60, 2.5 cm, or, for a leg whose best gait of all is above "
        "2.5 cm, 1 cm more than that gait. Beside it the random baseline, which has to hold it too."
    )
    yield from _bars(findings)
    for entry in drawn:
        yield heading(entry.name.replace("_", " ").capitalize())
        yield figure(folder / f"{entry.name}.png", entry.paper, entry.here)
    yield heading("Landscapes")
    yield _landscapes(findings.landscapes.values())
    yield heading("Means over all legs and runs, with standard deviation")
    yield _means(findings)
    yield heading("Means of each leg over its runs, with standard deviation, by the paper's count")
    yield _leg_means(findings)
    yield heading("Distinct codes")
    yield _distinct(findings)
    yield heading("Files and versions")
    yield paragraph(f"Beside this page: {', '.join(TABLES)}, and each figure as PNG and SVG.")
    yield paragraph(", ".join(f"{name} {value}" for name, value in code_versions().items()))


def _settings(findings: Findings) -> str:
    plan = findings.plan
    return (
        f"Robot {plan.robot.name}; legs {', '.join(str(leg) for leg in plan.legs)}, each locked in its "
        f"stance pose on the floor; all 120 gaits, {plan.duration_s:g} s each, with and without "
        f"self-rotation; then {', '.join(plan.optimizers)} with {plan.runs} seeded runs of "
        f"{plan.budget} evaluations, looked up in the landscapes with self-rotation. "
        f"Seed {plan.seed}. World: "
        + ", ".join(
            f"{name} {value}" for name, value in plan.world.model_dump().items() if name != "sensor_noise"
        )
    )


def _stuck(findings: Findings) -> str:
    """Return after how many codes the searches of this study were stuck."""
    means = {
        name: [float(findings.searches[leg, name, True].own_codes.mean()) for leg in findings.plan.legs]
        for name in findings.heuristics
    }
    each = ", ".join(f"{name} after {min(of):.0f} to {max(of):.0f}" for name, of in means.items())
    return (
        f"Distinct codes until a search is stuck, means of the runs of each leg: {each or 'none searched'}."
    )


def _claims(findings: Findings) -> str:
    rows = [
        (claim.claim, claim.rule, claim.measured, claim.beside, claim.verdict)
        for claim in claims_of(findings)
    ]
    return table(("claim of the paper", "holds here if", "measured here", "beside it", "verdict"), rows)


def _bars(findings: Findings) -> Iterator[str]:
    for paper_count in (False, True):
        counted = "By the paper's count" if paper_count else "Each gait paid for once"
        yield paragraph(f"{counted}:")
        rows = bar_rows(findings, paper_count=paper_count)
        legs = [f"leg {leg}" for leg in findings.plan.legs]
        header = ("optimizer", "evaluations", "bar", "mean", "verdict", *legs)
        yield table(header, _bar_lines(rows, len(legs)))


def _bar_lines(rows: list[BarRow], legs: int) -> Iterator[list[str]]:
    """Give a line for each optimizer and bar: all legs together, then each."""
    for first in range(0, len(rows), legs + 1):
        together, *each = rows[first : first + legs + 1]
        verdict = "holds" if together.holds else f"does not hold, by {cm(together.over_m)}"
        mean = cm(together.mean_m) + _share(together.share)
        head = [together.optimizer, str(together.evaluations), cm(together.limit_m), mean, verdict]
        yield head + [_leg_cell(row) for row in each]


def _leg_cell(row: BarRow) -> str:
    over = "" if row.holds else f" (+{cm(row.over_m)})"
    return cm(row.mean_m) + over + _share(row.share)


def _share(share: float) -> str:
    return "" if share == 1 else f" [{share:.0%} of the runs]"


def _landscapes(landscapes: Iterable[Landscape]) -> str:
    header = ("leg", "self-rotation", "gaits", "valid", "end left", "within 10 cm", "within 2.5 cm", "best")
    rows = [
        (
            str(landscape.spec.leg),
            landscape.spec.self_rotation,
            str(len(landscape.codes)),
            str(int(landscape.valid.sum())),
            f"{left_share(landscape):.0%}",
            str(within(landscape, 0.10)),
            str(within(landscape, 0.025)),
            cm(landscape.best_m),
        )
        for landscape in landscapes
    ]
    return table(header, rows)


def _means(findings: Findings) -> str:
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    rows = []
    for paper_count in (False, True):
        for name in findings.plan.optimizers:
            curve = findings.mean_curve(name, paper_count=paper_count)
            rows.append([name, "paper's" if paper_count else "fresh", *_curve_cells(curve, shown)])
    return table(("optimizer", "count", *[f"after {count}" for count in shown]), rows)


def _leg_means(findings: Findings) -> str:
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    rows = [
        [str(leg), name, *_curve_cells(findings.searches[leg, name, True].curve, shown)]
        for leg in findings.plan.legs
        for name in findings.plan.optimizers
    ]
    return table(("leg", "optimizer", *[f"after {count}" for count in shown]), rows)


def _curve_cells(curve: Curve, shown: list[int]) -> list[str]:
    return [
        f"{cm(curve.mean[at - 1])} ± {cm(curve.std[at - 1])}{_share(curve.share[at - 1])}" for at in shown
    ]


def _distinct(findings: Findings) -> str:
    """Return how many codes each search asks for by itself, and how many the paper's count pays for."""
    rows = []
    for name in findings.plan.optimizers:
        searches = [findings.searches[leg, name, True] for leg in findings.plan.legs]
        cells = [f"{search.own_codes.mean():.0f} / {search.distinct.mean():.0f}" for search in searches]
        rows.append([name, *cells])
    legs = [f"leg {leg}" for leg in findings.plan.legs]
    note = (
        "Mean over runs: codes of its own until the search is stuck / different codes that the paper's "
        "count buys."
    )
    return paragraph(note) + table(("optimizer", *legs), rows)
