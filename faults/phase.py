"""Phases of the matrix: what the robot is doing when something fails."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Phase:
    """What the robot does.

    Attributes:
        name: in words.
        motion: of the controller before, `walking`, `turning` or `standing`; None for trials.
        word: what the controller is told last, or None.
        wait_s: least and greatest time from then to the fault, in s.
        moves: whether the motion goes on by itself where nothing fails.
    """

    name: str
    motion: str | None
    word: str | None = None
    wait_s: tuple[float, float] = (0.0, 0.6)
    moves: bool = False


PHASES = {
    phase.name: phase
    for phase in (
        Phase(name="standing", motion="standing"),
        Phase(name="turning", motion="turning", moves=True),
        Phase(name="walking", motion="walking", moves=True),
        Phase(name="stopping", motion="walking", word="release", wait_s=(0.0, 0.1)),
        Phase(name="between trials", motion=None, wait_s=(0.1, 0.8)),
        Phase(name="sitting", motion="standing", word="sit", wait_s=(0.2, 1.2)),
    )
}
