"""`hexctl study`: the paper's experiments, and the benchmarks of transfer, holds and recovery."""

from collections.abc import Iterator
from typing import Any

from hexctl.cli.console import print_result
from hexctl.cli.settings import runs_folder
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.study.commands.study_progress import finish
from hexctl.study.study_options import MATRIX, PAPER, StudyOptions


@with_options(StudyOptions, rare=("optimizers", "runs"))
def study(asked: dict[str, Any], as_json: JsonOption = False) -> None:
    """Repeat the paper's experiments: all gaits of each failed leg, all optimizers, one report.

    Each gait is walked once and kept under runs/study-cache. After Ctrl-C the same command continues.
    """
    from hexctl.study.planned_study import planned_study

    options = StudyOptions(**asked)
    result = finish(planned_study(options, runs=runs_folder()), _not_judged(options))
    lines = [*result.lines(), f"report: {result.report}"]
    print_result(result.to_json() if as_json else "\n".join(lines))


def _not_judged(options: StudyOptions) -> Iterator[str]:
    from hexctl.study.paper.evidence import JUDGED_FROM_S, LATE, too_short
    from hexctl.study.paper.study_plan import StudyPlan

    if options.kind not in (PAPER, MATRIX):
        return
    if reason := too_short(options.duration_s):
        yield f"hexctl: claims will not be judged: {reason} (--duration {JUDGED_FROM_S:g})"
    budget = options.budget or StudyPlan.budget
    if budget <= LATE:
        yield (
            f"hexctl: claims about the first {LATE} evaluations will not be judged: {budget} evaluations, "
            f"needs more than {LATE} (--budget)"
        )
