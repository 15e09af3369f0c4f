"""The paper's study: all gaits of each failed leg, all optimizers on them, and the paper's claims."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from hexctl.study.experiment import Experiment
from hexctl.study.paper import study_report as report
from hexctl.study.paper.claims import claims_of, missed_lines
from hexctl.study.paper.evidence import StudyUncertainty, verdict_lines
from hexctl.study.paper.searches import Findings, search_all
from hexctl.study.paper.study_figures import study_drawings
from hexctl.study.paper.study_settings import StudySettings
from hexctl.study.walking import Silent, Work

if TYPE_CHECKING:
    from pandas import DataFrame

#: Gaits of a robot that knows of no failure: its default one, and the tripod.
DEFAULT_GAITS = ("demo", "tripod")


@dataclass(frozen=True, kw_only=True)
class StudyPlan(StudySettings, Experiment[Findings]):
    """The paper's study with its settings."""

    NAME: ClassVar[str] = "study"
    REPORT: ClassVar[str] = "report.html"
    TITLE: ClassVar[str] = "hexctl study"
    HEADING: ClassVar[str] = "Gaits for a failed leg: the paper's experiments repeated"

    numbers = staticmethod(report.study_json)
    tables = staticmethod(report.study_tables)
    drawings = staticmethod(study_drawings)
    sections = staticmethod(report.study_sections)

    def find(self, work: Work) -> Findings:
        """Walk all gaits and the default ones, search the landscapes and judge the claims."""
        uncertainty = StudyUncertainty.of(
            self.robot, self.world, self.duration_s, work.cache.folder.parent, failure=self.failure
        )
        landscapes = work.evaluate(self.specs())
        walks = self.default_walks(work)
        work.lap("landscapes")
        work.progress.stage("searches, leg by leg", len(self.searched_specs()))
        found = search_all(self, landscapes, work.progress.step)
        work.lap("searches")
        return replace(found, default_walks=walks, claims=tuple(claims_of(found)), uncertainty=uncertainty)

    def default_walks(self, work: Work) -> "DataFrame":
        """Return the walks of each leg with `DEFAULT_GAITS`, in the landscapes with self-rotation."""
        from pandas import DataFrame

        places = [replace(self.searched_specs()[0], leg=leg) for leg in self.legs]
        work.progress.stage("the robot's own gaits", len(self.legs))
        walks = replace(work, progress=Silent()).walk([(place, DEFAULT_GAITS) for place in places])
        work.progress.step(len(self.legs))
        return DataFrame(
            {
                "leg": place.leg,
                "gait": walk.case,
                "status": walk.status,
                "signed_m": walk.signed_m,
                "distance_m": walk.distance_m,
                "final_m": abs(walk.signed_m) if walk.status == "ok" else float("nan"),
            }
            for place, some in zip(places, walks, strict=True)
            for walk in some
        )

    def lines(self, found: Findings) -> list[str]:
        """Return the missed claims and bars as lines of text."""
        claims = verdict_lines((claim.verdict, claim.claim) for claim in found.claims)
        return [*claims, *missed_lines(found), *found.uncertainty.lines]
