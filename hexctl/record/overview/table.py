"""The table of a session, as a text panel."""

from hexctl.record.overview.trials import Overview, OverviewTrial, deviation_text

COLUMNS = ("trial", "code", "slots", "deviation", "distance", "status", "best so far")


def make_table(overview: Overview) -> str:
    """Return the text: title, facts, and a row per trial with the best one in bold."""
    best = overview.best
    rows = [
        _row(_cells(trial, so_far), bold=trial is best)
        for trial, so_far in zip(overview.trials, overview.best_so_far(), strict=True)
    ]
    facts = "\n".join(f"- {fact}" for fact in (*overview.facts, *_how_to_open(overview)))
    head = [_row(COLUMNS, bold=False), "|--:|--:|---|--:|--:|---|--:|"]
    return "\n".join([f"## {overview.title}", "", facts, "", *head, *rows]) + "\n"


def _how_to_open(overview: Overview) -> tuple[str, ...]:
    if not any(trial.address for trial in overview.trials):
        return ()
    return ("click ▶ to see a trial walk; ← at the top comes back",)


def _cells(trial: OverviewTrial, best: OverviewTrial | None) -> tuple[str, ...]:
    distance = "-" if trial.distance_m is None else f"{trial.distance_m:.2f} m"
    so_far = "-" if best is None or best.score_m is None else f"{best.score_m:.3f} m"
    slots = ",".join(str(slot) for slot in trial.slots)
    off = deviation_text(trial.deviation_m)
    number = str(trial.index) if trial.address is None else f"[▶ {trial.index}]({trial.address})"
    return number, str(trial.code), slots, off, distance, trial.status, so_far


def _row(cells: tuple[str, ...], *, bold: bool) -> str:
    return "| " + " | ".join(f"**{cell}**" if bold else cell for cell in cells) + " |"
