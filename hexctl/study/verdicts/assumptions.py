"""What the paper leaves open, how hexctl reads it, and what changes when it is read otherwise."""

from dataclasses import dataclass, replace

from hexctl.control.assessment.uncertainty_store import known_uncertainty
from hexctl.robot.configs import config_root
from hexctl.study.reports.texts import texts
from hexctl.study.verdicts.claim_evidence import cm


@dataclass(frozen=True)
class Assumption:
    """One reading of the paper.

    Attributes:
        about: what has to be decided.
        paper: what the paper says, with the section.
        here: what hexctl does.
        otherwise: what changes when it is read otherwise, with the number where one was measured.
    """

    about: str
    paper: str
    here: str
    otherwise: str


HEADER = ("to decide", "the paper", "hexctl", "read otherwise")


def assumptions() -> tuple[Assumption, ...]:
    """All readings; the last one has the simulation's uncertainty of `ant` as it ships with hexctl."""
    *others, simulator = (Assumption(**one) for one in texts("assumptions"))
    return (*others, replace(simulator, otherwise=f"{simulator.otherwise} {_uncertainty_text()}"))


def _uncertainty_text() -> str:
    """By how much ends of walks move when they are computed otherwise, from `configs/uncertainty.yaml`."""
    known = known_uncertainty("ant", folder=config_root())
    if known is None:
        return "What another step would change was not measured."
    return (
        f"Half the step moves ends by {cm(known.step_m)}, MuJoCo's own solver tolerance by "
        f"{cm(known.solver_m)}, contacts a third softer or harder by {cm(known.contact_m)} (rms of "
        f"{known.walks} walks)."
    )


def assumption_rows() -> list[tuple[str, str, str, str]]:
    """The readings as rows of a table under `HEADER`."""
    return [(one.about, one.paper, one.here, one.otherwise) for one in assumptions()]


def assumptions_markdown() -> str:
    """The readings as a table in Markdown, as in docs/assumptions.md."""
    rows = [HEADER, ("---",) * len(HEADER), *assumption_rows()]
    return (
        "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows) + "\n"
    )
