"""What the paper leaves open, how hexctl reads it, and what changes when it is read otherwise."""

from dataclasses import dataclass, replace

from hexctl.control.assessment.uncertainty_store import known_uncertainty
from hexctl.robot.configs import config_root
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


#: Numbers are those of `ant` on the flat floor, all 120 gaits of 30 s, unless another setting is named. What
#: step, solver and contacts change is added by `assumptions`.
_WRITTEN = (
    Assumption(
        "The failed leg",
        '"we rather let the malfunctioning legs contact the floor" (Sec. III-A); neither its joints '
        "nor their torque are described",
        "`locked`: the leg is held in its stance pose and props the robot",
        "It decides more than anything else. `locked`: 120 of 120 gaits valid after the turn, 12 "
        "within 10 cm, 4 within 2.5 cm. `limp` (no torque, still on the floor): 53 valid, 2 and 0. "
        "`missing`: 50 valid, 8 and 0. Without the turn all valid gaits of leg 3 end on the left "
        "when it is locked, 65 % when limp.",
    ),
    Assumption(
        "Where the self-rotation ends",
        '"we allow the robot to rotate in its own axis to self-adjust the balance" (Sec. III-B); the '
        "angle is not given",
        "`rear`: the failed leg trails",
        "`front`: the leg leads, as leg 1 does without a turn. Of 40 gaits 4 end within 10 cm, about "
        "the same share; their median is 0.38 m off the line instead of 0.80 m. For a leg that "
        "points ahead the turn to the rear makes 70 % of the gaits worse.",
    ),
    Assumption(
        "Where the walk begins",
        "not stated whether the robot is put down turned or turns by itself",
        "It turns by itself, in closed loop, to within 0.1°; the line of travel is the commanded one",
        "A degree of miss moves the end of a 30 s walk by 8 to 14 cm.",
    ),
    Assumption(
        "Pace",
        'u depends on "the actual or simulation time" (Eq. 5): one cycle per unit of t, whose unit '
        "is not given",
        "0.9 cycles/s, that of the demo model whose equations these are",
        "Distances scale with it: 4.46 m in 30 s without slip, 4.95 m at one cycle per second.",
    ),
    Assumption(
        "Start of the walk",
        "Eq. 3 and 4 have full amplitude from the first instant",
        "Amplitude and height rise from zero in 2 s, as in the demo model; the 30 s include them",
        "A walk that begins at once is about 0.15 m longer; other effects were not measured.",
    ),
    Assumption(
        "Slots or order",
        'Eq. 5 uses g_i as the phase of leg i; the prose reads g as an order ("leg 5, leg 1, leg 2, '
        '... are used in such order") (Sec. II)',
        "Eq. 5: g_i is the slot of leg i; swings follow one another in descending slots",
        "The same 120 gaits get other codes (and other phases at the start). Distributions and "
        "random search stay as they are; a search that follows neighbouring codes sees another "
        "landscape.",
    ),
    Assumption(
        "The slot of the failed leg",
        '"5! = 120" gaits of the remaining legs (Sec. II); which slot stays free is not stated',
        "The failed leg k keeps slot k",
        "Another slot shifts the start of the cycle, nothing else: about 1.5 cm rms at the end, for "
        "gaits within 0.5 m of the line.",
    ),
    Assumption(
        "Direction of θ",
        "Eq. 2 and 3 as printed move the foot on the floor toward θ, and the body away from it",
        "The heading is where the body goes",
        "Left and right, front and rear change places.",
    ),
    Assumption(
        "The objective F",
        '"the deviation in the commanded direction" (Sec. III-B), in metres',
        "|y| at the end of 30 s",
        "The mean of |y| along the way ranks the gaits nearly alike (Spearman 0.996) and is smaller: "
        "30 gaits within 10 cm instead of 12. The largest |y|: 0.9998, 12 gaits. After 20 s instead "
        "of 30 s, 28 gaits are within 10 cm, after 10 s 60.",
    ),
    Assumption(
        "Robots that do not walk",
        "not mentioned; standing still has F = 0",
        "A trial that falls, or makes less than half of the ideal distance, is behind every valid one",
        "Without the floor, robots that circle or stand count as good. With `locked` no gait fails "
        "after the turn; with `limp` 67 of 120 do.",
    ),
    Assumption(
        "What an evaluation is",
        '"120 function evaluations at the maximum" (Sec. III-B)',
        "For the paper's claims a code that is asked for again costs again",
        "Where repetitions are free, every search knows the best gait after 120 evaluations; the "
        "report has both.",
    ),
    Assumption(
        "Population of DE",
        '"population size was set as 10" for particle swarms; CR and F for DE, no population (Sec. III-B)',
        "10 for all",
        "Populations of 5 to 30 reach 5.0 to 6.2 cm after 20 evaluations and 0.9 to 2.1 cm after 60.",
    ),
    Assumption(
        "Where the searches move",
        '"it becomes possible to search in the space of numbers" (Sec. III-B)',
        "The line 1..120, rounded to the nearest code",
        "In one dimension DE's crossover rate has no effect; searched as factorial digits it would.",
    ),
    Assumption(
        "DPS",
        "a reference (CEC 2021), no equations",
        "A reconstruction from published parents: difference vectors, and an archive of successful parents",
        "Unknown. Its results stand for the reconstruction only.",
    ),
    Assumption(
        "Friction, servos, contact",
        '"particular friction parameters in the actuators and the floor" (Sec. II); no values',
        "Friction 0.8, 15 N·m/rad, contacts of 20 ms",
        "In three worlds with factors of 1.3, 1.3 and 1.5 on them, 12 gaits are within 10 cm each "
        "time, but only 4 of them are the same; within 2.5 cm are 4, 9 and 5.",
    ),
    Assumption(
        "Simulator",
        '"the Coppelia Simulation software" (Sec. III); engine and step are not stated',
        "MuJoCo, elliptic friction cone, 2 ms, solver tolerance 1e-12",
        "With the pyramidal cone the same walk turned by 45° ends 17 to 49 cm away (rms), with the "
        "elliptic one 0.0 to 0.8 cm.",
    ),
)

HEADER = ("to decide", "the paper", "hexctl", "read otherwise")


def assumptions() -> tuple[Assumption, ...]:
    """All readings; the last one has the simulation's uncertainty of `ant` as it ships with hexctl."""
    *others, simulator = _WRITTEN
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
