"""The spec of a session: the resolved options of its search, and measurements at its beginning."""

import hmac
import math
import secrets
from collections.abc import Collection
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any

from hexctl.adapt.adapt_options import AdaptOptions
from hexctl.adapt.objectives import OBJECTIVES
from hexctl.control.trial_plan import Hold, SelfRotation
from hexctl.errors import InputError, argument
from hexctl.files import read_secret, state_folder, write_new
from hexctl.recording.sessions.session_overview import METRES, mark_text, score_text
from hexctl.robot.failure import Failure

#: Options that may name code, `module:Name`, with the argument that gives such a part instead.
_PARTS = {"optimizer": "optimizer", "objective": "objective", "backend": "servos", "recovery": "recovery"}

#: Begins names of the running script, which is loaded already.
_SCRIPT = "__main__:"

#: Length of the secret that seals sessions, in hexadecimal.
KEY_BYTES = 64

#: The recovery of sessions whose trials watch no legs.
UNWATCHED = "walk-on"


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionSpec(AdaptOptions):
    """The options of a search, and measurements at its beginning; stored with the session.

    Options without a value hold the choice: a session continues as it began, whatever the defaults are then.
    Options with a narrower type are declared again.

    Attributes:
        robot_fingerprint: of the robot's description when the session began.
        objective_label: what a custom objective measures; empty for those of hexctl.
        objective_unit: unit of the score.
        uncertainty_caveat: how the session's walks differ from those that measured the uncertainty.
        confirmed_uncertainty_m: of walks at a finer time step that confirm an end; 0 if unknown, without
            confirmation.
        noise_m: standard deviation between trials of one gait that `bayes` assumes before any repeat; None
            without `bayes`, and for steered walks.
        prior_digest: hash of the prior when the session began.
        baseline_gaits: named gaits that are walked before the first trial.
        sag_rad: static deflection of each joint in the stance before the first trial, 18 numbers, None for an
            unmeasured joint; None if the prior or the robot does not provide it.
        versions: of the software that decides how trials end, by package.
        seal: shows that this user began the session here, with its robot; empty for a simulation.
    """

    robot: str = "ant"
    world: str | None = "flat"
    failure: tuple[Failure, ...] = ()
    credentials: str | None = None
    optimizer: str = "random"
    objective: str = "final"
    prior: str | None = None
    uncertainty_m: float = 0.0
    self_rotation: SelfRotation = "rear"
    hold: Hold = "none"
    body_raise: float = 0.0
    recovery: str = UNWATCHED
    home_m: list[float] | None = None

    robot_fingerprint: str = ""
    objective_label: str = ""
    objective_unit: str = "m"
    uncertainty_caveat: str = ""
    confirmed_uncertainty_m: float = 0.0
    noise_m: float | None = None
    prior_digest: str = ""
    baseline_gaits: list[str] = field(default_factory=list)
    sag_rad: list[float | None] | None = None
    versions: dict[str, str] = field(default_factory=dict)
    seal: str = ""

    @property
    def simulated(self) -> bool:
        """Whether each trial has its own simulation, from the same start."""
        return self.backend == "sim"

    @property
    def score_label(self) -> str:
        """What the score is, in words."""
        known = OBJECTIVES.get(self.objective)
        return known.label if known is not None else self.objective_label or self.objective

    @property
    def target_share(self) -> float | None:
        """The target as a share of the ideal distance; None if not given as one."""
        text = str(self.target).strip()
        return float(text.removesuffix("%")) / 100 if text.endswith("%") else None

    @property
    def target_text(self) -> str | None:
        """The target, for a person; both figures for a share of the distance. None without a target."""
        if self.target_m is None:
            return None
        unit = self.objective_unit
        rounded = float(f"{self.target_m:.3g}")
        text = mark_text(rounded) if unit == METRES else f"{rounded:g} {unit}".rstrip()
        if self.target_share is None:
            return text
        share = self.target_share
        return f"{text} ({100 * share:g} % of {self.target_m / share:.2f} {unit})"

    def score_text(self, score: float) -> str:
        """Score with its unit, for a person; a length in cm."""
        return score_text(score, self.objective_unit)

    @property
    def uncertainty_text(self) -> str:
        """The simulation's own uncertainty of a score; empty if unknown, or if the score is no end."""
        uncertain = self.uncertainty_m > 0 and self.objective == "final"
        return score_text(self.uncertainty_m, METRES) if uncertain else ""

    @property
    def foreign_parts(self) -> dict[str, str]:
        """Options with the names of imported code, `module:Name`."""
        named = {option: str(getattr(self, option)) for option in _PARTS}
        return {
            option: name for option, name in named.items() if ":" in name and not name.startswith(_SCRIPT)
        }

    def own_seal(self) -> str:
        """Seal of this user for the robot; empty for a simulation, and if the state folder has no secret."""
        chosen = [
            str(getattr(self, name))
            for name in ("robot", "backend", "connect", "port", "link", "credentials")
        ]
        key = b"" if self.simulated else _sealing_key()
        return hmac.digest(key, repr(chosen).encode(), "sha256").hex() if key else ""

    def check_trusted(self, given: Collection[str], *, trust: bool) -> None:
        """Check that a session imports only trusted code and chooses no robot for another user.

        `given` arguments replace parts of it. Raises InputError without `trust` for a part with a name
        `module:Name`, and for a robot if this user did not begin the session on this computer.
        """
        for option, name in self.foreign_parts.items():
            if not trust and _PARTS[option] not in given:
                raise InputError(
                    f"session: its {option} is code to be imported, got {name!r}; allowed: names that hexctl "
                    f"ships; if you trust the session and that module, add {argument('trust')}"
                )
        seals = [seal.encode() for seal in (self.seal, self.own_seal())]
        own = self.simulated or (all(seals) and hmac.compare_digest(*seals))
        if not (own or trust or "servos" in given):
            raise InputError(
                f"session: another user or computer may have chosen its robot, {self.robot} by "
                f"{self.backend} at {self.connect or self.port or self.link or 'the default'}; to move "
                f"that one, add {argument('trust')}"
            )

    def as_json(self) -> dict[str, Any]:
        """The spec as `hexctl adapt --json` prints it: leg and kind of the failure, heading in degrees."""
        values = asdict(self)
        del values["heading_rad"], values["seal"]
        return {
            **values,
            "failed_leg": self.broken.leg,
            "failure": str(self.broken),
            "heading_deg": round(math.degrees(self.heading_rad), 9),
            "target_share": self.target_share,
        }


def _sealing_key() -> bytes:
    """Secret of this user on this computer, made when first asked for; empty if it cannot be kept."""
    path = state_folder() / "sessions.key"
    with suppress(OSError, InputError):  # another process may make it at the same time
        if not path.exists():
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            write_new(path, secrets.token_hex(KEY_BYTES // 2), "session", mode=0o600)
    with suppress(OSError):
        key = read_secret(path, 2 * KEY_BYTES)
        return key if len(key) == KEY_BYTES else b""
    return b""
