"""Options of `hexctl identify`."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, ClassVar

from hexctl.backends.robot_options import RecordedOptions
from hexctl.backends.sim.world import World
from hexctl.errors import InputError, UnusedError, argument
from hexctl.files import check_new, write_trouble
from hexctl.options import UNTYPED, Range, Typed, check_fields

#: Why an option of motions is refused.
WITHOUT_LOGS = "got LOG too, with which nothing moves; leave it out, or leave out LOG"


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyOptions(RecordedOptions):
    """Options of an identification; raises InputError for invalid values."""

    PANEL: ClassVar = "Result"

    world: Annotated[str | Path | World | None, Typed(words="worlds")] = None
    """Simulated world: stand, or a YAML file with on_stand. (default: stand)

    Only with sim. In Python also a World.
    """

    output: Annotated[str | Path | None, Typed(short="o")] = None
    """Robot file to write, new, .yaml: the robot's with the servos found, and a picture next to it. (default:
    none)
    """

    p_gain: Annotated[int | None, Range(low=1, whole=True)] = None
    """P gain of the firmware on the robot, for runs of a servo on a bench, {}. (default: the largest of the
    runs)
    """

    logs: Annotated[Sequence[Path] | None, UNTYPED] = None
    """Recordings, or runs on a bench; None if the robot is to move."""

    def __post_init__(self) -> None:
        check_fields(self)

    def check(self) -> None:
        """Raise UnusedError for options of motions with logs, and of a bench without its runs."""
        moving = () if not self.logs else (one for one in fields(RecordedOptions) if one.name != "robot")
        for field in moving:
            if getattr(self, field.name) != field.default:
                raise UnusedError(f"{argument(field.name)}: {WITHOUT_LOGS}")
        if not self.logs:
            RecordedOptions.check(self)
        if self.p_gain is not None and not any(Path(log).suffix == ".json" for log in self.logs or ()):
            raise UnusedError(f"{argument('p_gain')} requires runs of a servo on a bench: LOG.json")

    def check_output(self) -> None:
        """Raise InputError for an output that cannot be written, and for a robot file whose meshes fail."""
        if self.output is None:
            return
        path = Path(self.output)
        if path.suffix != ".yaml":
            raise InputError(f"{argument('output')}: got {path.name}; allowed: a new file .yaml")
        for file in (path, picture_of(path)):
            check_new(file, argument("output"))
        if not path.parent.is_dir() or write_trouble(path.parent) is not None:
            raise InputError(f"{argument('output')}: got {path}; allowed: a file in a writable folder")
        from hexctl.robot.loader import load_robot_file

        _ = load_robot_file(str(self.robot)).meshes


def picture_of(output: Path) -> Path:
    """Path of the picture next to a robot file."""
    return output.with_suffix(".png")
