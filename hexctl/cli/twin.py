"""The robot behind `hexctl serve` and `hexctl board`: whose servos; simulated, in which world, how failed."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexctl.backends.base import LegServos
from hexctl.backends.registry import BackendOptions
from hexctl.cli.options import failure_of
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot_file

if TYPE_CHECKING:
    from hexctl.backends.sim.world import World

#: Where it stands when nobody says.
DEFAULT_WORLD = "flat"


def failure_words(failure: Failure | None) -> str:
    """Return a failure as a person would say it: `leg 5 locked`, or `none`."""
    return "none" if failure is None else f"leg {failure.leg} {failure}"


def note_of_twin(servos: LegServos, failure: Failure | None) -> str | None:
    """Return what is to be said where a simulation over a link has another failure than this end supposes."""
    there, here = (servos.simulated or {}).get("failure"), failure_words(failure)
    if there in (None, here):
        return None
    return f"the simulated robot there has failure {there}, this end walks as with failure {here}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Twin:
    """The options that say what moves, as values."""

    backend: str
    robot: str
    world: str | None
    failed_leg: int | None
    failure: str | None
    seed: int

    def check(self) -> None:
        """Raise InputError for options that only a simulation knows, before anything is opened."""
        for option in ("world", "failed_leg", "failure"):
            if self.backend != "sim" and (value := getattr(self, option)) is not None:
                raise InputError(
                    f"--{option.replace('_', '-')}: got {value} with --backend {self.backend}; "
                    "allowed: with sim"
                )
        if self.seed < 0:
            raise InputError(f"--seed: got {self.seed}; allowed: 0 or more")
        if self.seed and self.backend == "mavlink":
            raise InputError(f"--seed: got {self.seed} with --backend mavlink; allowed: with sim")

    def options(self) -> BackendOptions:
        """Return what its backend is made with: in real time, from the robot's file."""
        file = load_robot_file(self.robot)
        return BackendOptions(
            robot=file.robot,
            world=self._world(),
            failure=failure_of(self.failed_leg, self.failure),
            seed=self.seed,
            realtime=True,
            robot_file=file,
        )

    def words(self) -> dict[str, str] | None:
        """Return `world` and `failure` of a simulation, as a person would say them; None of real servos."""
        if self.backend != "sim":
            return None
        failure = failure_of(self.failed_leg, self.failure)
        return {"world": self.world or DEFAULT_WORLD, "failure": failure_words(failure)}

    def _world(self) -> "World | None":
        if self.backend != "sim":
            return None
        from hexctl.backends.sim.world import load_world

        return load_world(self.world or DEFAULT_WORLD)
