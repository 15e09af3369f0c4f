"""Options of `hexctl identify`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from hexctl.backends.robot_options import RecordedOptions
from hexctl.errors import InputError, argument
from hexctl.options import Range, Typed, check_fields


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyOptions(RecordedOptions):
    """Options of an identification; raises InputError for invalid values."""

    PANEL: ClassVar = "Result"

    output: Annotated[str | Path | None, Typed(short="o")] = None
    """Robot file to write, new, .yaml: the robot's with the servos found, and a picture next to it. (default:
    none)
    """

    p_gain: Annotated[float | None, Range(low=0, above=True)] = None
    """P gain of the firmware on the robot, for runs of a servo on a bench, {}. (default: the largest of the
    runs)
    """

    def __post_init__(self) -> None:
        check_fields(self)

    def check_output(self) -> None:
        """Raise InputError for an output that exists or is no .yaml."""
        if self.output is None:
            return
        path = Path(self.output)
        if path.suffix != ".yaml":
            raise InputError(f"{argument('output')}: got {path.name}; allowed: a new file .yaml")
        for file in (path, picture_of(path)):
            if file.exists():
                raise InputError(f"{argument('output')}: {file} exists; allowed: a new file")


def picture_of(output: Path) -> Path:
    """Path of the picture next to a robot file."""
    return output.with_suffix(".png")
