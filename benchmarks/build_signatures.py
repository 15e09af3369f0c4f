"""Learn the signatures of failed legs: `python -m benchmarks.build_signatures FILE FOLDER`.

Walks with drawn failures, and intact ones, are simulated. FOLDER keeps what `BodyBalance` looks at in them. A
network is then trained by Adam to tell which leg failed, if any: a choice among seven (D. McFadden,
"Conditional logit analysis of qualitative choice behavior", 1974).
"""

import math
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.sim.world import World, load_randomization
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.controllers import Controller
from hexctl.control.monitor.body_balance import KNOWN_AFTER_CYCLES, LOOK_TICKS, SETTLED_S, BodyBalance
from hexctl.control.monitor.leg_signatures import SENSORS, LegSignatures, save_signatures
from hexctl.control.monitor.phase_habit import PARTS
from hexctl.control.preparation import WalkStart
from hexctl.control.trial import planned_walk
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import Gait, half_amplitude_turn_rate_rad_s, make_gait
from hexctl.robot.failure_grammar import parse_failure_event
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.study.held_out import with_sensors
from hexctl.types import N_LEGS, FloatArray, RobotState

#: Failures, and gaits, of which the first is drawn more often.
KINDS, GAITS = ("locked", "limp", "missing"), ("tripod", "tripod", "tripod", "ripple", "wave", "demo")

#: Failures drawn in a world, kinds of healthy walks there, and their length.
FAILURES, HEALTHY, HEALTHY_S = 6, ("line", "line", "turning", "turning"), 30.0

#: Robots of `real` on floors of this roughness and length of bumps, in m.
BUMPY, ROUGHNESS_M, LENGTH_M = "bumpy", (0.001, 0.005), (0.1, 0.5)

#: From this many cycles after a failure on, its signature is complete enough to learn.
SHOWS_AFTER_CYCLES = 0.75

#: Networks whose mean is shipped, and their size and training.
NETWORKS, UNITS, PASSES, BATCH, RATE, DECAY = 3, 16, 12, 128, 3e-3, 1e-3


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Walks of a robot in some worlds of a family; healthy ones if no leg fails `at_s`."""

    robot: str = "ant"
    family: str
    first: int
    worlds: int
    at_s: float | None = None
    after_cycles: float = 2.2
    step_s: float = 0.004

    @property
    def name(self) -> str:
        """Name of its file."""
        kind = "healthy" if self.at_s is None else f"{self.at_s:g}s"
        return f"{self.robot}-{self.family}-{self.first}-{self.worlds}-{kind}.npz"


#: What is learned from.
BATCHES = (
    *(
        Batch(family=family, first=15000, worlds=10, at_s=6, after_cycles=2.6, step_s=0.002)
        for family in ("real", BUMPY, "transfer", "randomised")
    ),
    Batch(family=BUMPY, first=15000, worlds=5, step_s=0.002),
    *(Batch(family=family, first=15010, worlds=10, at_s=5) for family in ("real", BUMPY, "transfer")),
    *(Batch(family=family, first=15010, worlds=4) for family in (BUMPY, "transfer", "real")),
    Batch(family="randomised", first=15010, worlds=5, at_s=5),
    *(Batch(family=family, first=15020, worlds=10, at_s=6.5) for family in ("real", "transfer")),
    *(Batch(family=family, first=15020, worlds=5, at_s=6.5) for family in ("randomised", BUMPY)),
    *(
        Batch(robot=robot, family=family, first=15010, worlds=worlds, at_s=at_s)
        for robot, worlds, at_s in (("pexod", 5, 5.5), ("phantomx", 4, 9))
        for family in ("real", "transfer")
    ),
)


@dataclass(frozen=True, kw_only=True)
class LearningWalk:
    """A walk, and when which leg fails in it; leg 0 and never in a healthy one."""

    trial: SimTrial
    leg: int = 0
    at_s: float = math.inf


def walks_of(batch: Batch) -> list[LearningWalk]:
    """The drawn walks of a batch."""
    robot = load_robot(batch.robot)
    family = load_randomization("real" if batch.family == BUMPY else batch.family)
    mode = "healthy" if batch.at_s is None else "fail"
    stream = sum(map(ord, batch.family + mode + batch.robot))
    walks: list[LearningWalk] = []
    for number, world in enumerate(family.members(batch.first, batch.worlds), batch.first):
        random = np.random.default_rng([number, stream])
        place = partial(SimTrial, robot=robot, failures=None, world=_world(batch, world, random), seed=number)
        if batch.at_s is None:
            walks += [LearningWalk(trial=place(plan=_healthy(robot, kind, random))) for kind in HEALTHY]
            continue
        for drawn in random.permutation(N_LEGS * len(KINDS))[:FAILURES].tolist():
            leg, kind = 1 + drawn // len(KINDS), KINDS[drawn % len(KINDS)]
            plan, at_s = _failing(robot, batch, random)
            events = (parse_failure_event(f"{leg}:{kind}@{at_s}"),)
            walks.append(LearningWalk(trial=place(plan=plan, events=events), leg=leg, at_s=at_s))
    return walks


def _world(batch: Batch, world: World, random: np.random.Generator) -> World:
    changes: dict[str, float] = {"time_step_s": batch.step_s}
    if batch.family == BUMPY:
        changes["roughness_m"] = random.uniform(*ROUGHNESS_M)
        changes["roughness_length_m"] = random.uniform(*LENGTH_M)
    return World.model_validate(with_sensors(world).model_dump() | changes)


def _failing(robot: Robot, batch: Batch, random: np.random.Generator) -> tuple[TrialPlan, float]:
    gait = make_gait(robot, str(random.choice(GAITS)))
    at_s = round((batch.at_s or 0.0) + random.uniform() / gait.pace_hz, 2)
    heading_rad = math.radians(random.uniform(-180, 180))
    duration_s = round(at_s + batch.after_cycles / gait.pace_hz, 2)
    plan = TrialPlan(gait=gait, heading_rad=heading_rad, duration_s=duration_s)
    return replace(plan, self_rotation="none", hold="line"), at_s


def _healthy(robot: Robot, kind: str, random: np.random.Generator) -> TrialPlan:
    gait = make_gait(robot, str(random.choice(GAITS)))
    heading_rad = math.radians(random.uniform(-180, 180))
    plan = TrialPlan(gait=gait, heading_rad=heading_rad, duration_s=HEALTHY_S)
    if kind == "line":
        return replace(plan, self_rotation="none", hold="line")
    turn = float(random.choice((-1, 1)) * random.uniform(0.2, 1))
    rate_rad_s = turn * half_amplitude_turn_rate_rad_s(robot, gait)
    return replace(plan, travel=float(random.choice((0.0, 0.5))), turn_rate_rad_s=rate_rad_s)


#: Of some looks: deviations and sizes of each kind of what is seen, walks and cycles since the failure.
Looks = dict[str, NDArray[Any]]


class Observer:
    """Looks of walks as `BodyBalance` has them, with and without contacts."""

    def __init__(self, walks: list[LearningWalk], period_s: float) -> None:
        self._walks, self._period_s = walks, period_s
        pace_hz = np.array([walk.trial.plan.gait.pace_hz for walk in walks])
        self._at_s = np.array([walk.at_s for walk in walks])
        self._until_s = np.array([walk.trial.plan.duration_s for walk in walks])
        self._pace_hz, self._from_s = pace_hz, SETTLED_S + KNOWN_AFTER_CYCLES / pace_hz
        self._balances = {seen: _blank(len(walks), period_s, pace_hz, seen) for seen in SENSORS}
        self._ticks, self._found = 0, list[Looks]()

    def update(self, state: RobotState, phases: FloatArray) -> None:
        """Take the state of a tick, and the normalised times of the legs then, (n, 6)."""
        for seen, balance in self._balances.items():
            balance.update(state if seen == "contacts" else replace(state, foot_contacts=None), phases)
        self._ticks += 1
        now_s = self._ticks * self._period_s
        some = np.flatnonzero((now_s >= self._from_s) & (now_s < self._until_s))
        if self._ticks % LOOK_TICKS or not some.size:
            return
        look: Looks = {"walk": some, "cycles": ((now_s - self._at_s) * self._pace_hz)[some]}
        for seen, balance in self._balances.items():
            assert balance.looked is not None
            cut = PARTS * _channels(seen)
            look[f"{seen}_pattern"] = balance.looked[some, :cut].astype(np.float32)
            look[f"{seen}_sizes"] = balance.looked[some, cut:-1].astype(np.float32)
        self._found.append(look)

    @property
    def looks(self) -> Looks:
        """All looks."""
        return {name: np.concatenate([look[name] for look in self._found]) for name in self._found[0]}


def _blank(walks: int, period_s: float, pace_hz: FloatArray, seen: str) -> BodyBalance:
    """A balance that knows no signatures."""
    kinds, channels = (1, 2) if seen == "lean" else (2, 2 + N_LEGS)
    patterns = np.zeros((1, channels, PARTS))
    blank = LegSignatures(
        patterns=patterns, sizes=np.zeros((1, 2 * kinds + 1)), biases=np.zeros(1), outputs=np.zeros(2)
    )
    each = np.stack([patterns] * walks)
    return BodyBalance((walks,), period_s, pace_hz * period_s, lambda _seen: blank, lambda _leg, _seen: each)


class ObservedWalk(Controller):
    """The planned walk, with an observer."""

    def __init__(self, start: WalkStart, walks: list[LearningWalk]) -> None:
        self.walk = planned_walk(start)
        self.hold, self.observer = self.walk.hold, Observer(walks, start.period_s)

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, (n, 18)."""
        if self.walk.leg_phases is not None:
            self.observer.update(state, self.walk.leg_phases)
        return self.walk.targets_rad(step, state)


def observed(walks: list[LearningWalk]) -> Looks:
    """Simulate walks and return their looks."""
    places = {id(walk.trial.plan): place for place, walk in enumerate(walks)}
    made: list[tuple[list[int], ObservedWalk]] = []

    def make(start: WalkStart) -> ObservedWalk:
        order = [places[id(plan)] for plan in start.plans]
        made.append((order, ObservedWalk(start, [walks[place] for place in order])))
        return made[-1][1]

    run_sim_trials([walk.trial for walk in walks], 1, make, apart=True)
    return joined([(order, walk.observer.looks) for order, walk in made])


def joined(parts: list[tuple[list[int], Looks]]) -> Looks:
    """Looks of several groups of walks, each with the places of its walks."""
    each = [looks | {"walk": np.array(order)[looks["walk"]]} for order, looks in parts]
    return {name: np.concatenate([looks[name] for looks in each]) for name in each[0]}


@dataclass(frozen=True, eq=False)
class Examples:
    """What is learned from: features of each leg, (n, 6, f), and the failed leg or 0, (n,)."""

    features: NDArray[np.float32]
    legs: NDArray[np.int64]


def examples(batches: list[tuple[list[LearningWalk], Looks]], seen: str) -> Examples:
    """Examples of all walks, and of their mirror images."""
    parts = [_of_walk(walk, at, looks, seen) for walk, at, looks in _by_walk(batches)]
    features, legs = (np.concatenate(each) for each in zip(*parts, strict=True))
    return Examples(np.concatenate([features, mirrored(features, seen)]), np.concatenate([legs, legs]))


def _by_walk(
    batches: list[tuple[list[LearningWalk], Looks]],
) -> Iterator[tuple[LearningWalk, NDArray[Any], Looks]]:
    for walks, looks in batches:
        since = looks["cycles"]
        used = (since < 0) | (since >= SHOWS_AFTER_CYCLES)
        for place, walk in enumerate(walks):
            yield walk, np.flatnonzero(used & (looks["walk"] == place)), looks


def _of_walk(
    walk: LearningWalk, at: NDArray[Any], looks: Looks, seen: str
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    legs = np.where(looks["cycles"][at] < 0, 0, walk.leg)
    turns = to_legs(walk.trial.robot, walk.trial.plan.gait, seen)
    patterns = np.einsum("nf,lgf->nlg", looks[f"{seen}_pattern"][at], turns)
    sizes = np.repeat(looks[f"{seen}_sizes"][at, np.newaxis], N_LEGS, axis=1)
    return np.concatenate([patterns, sizes], axis=-1).astype(np.float32), legs


def to_legs(robot: Robot, gait: Gait, seen: str) -> FloatArray:
    """Matrices that turn deviations of a robot into the frame of each leg, (6, f, f)."""
    size = PARTS * _channels(seen)
    units = np.eye(size).reshape(size, -1, PARTS)
    basis = LegSignatures(patterns=units, sizes=np.zeros(0), biases=np.zeros(0), outputs=np.zeros(0))
    return np.stack([basis.of_leg(robot, gait, leg).reshape(size, size) for leg in range(1, N_LEGS + 1)])


def _channels(seen: str) -> int:
    return 2 if seen == "lean" else 2 + N_LEGS


def mirrored(features: FloatArray, seen: str) -> FloatArray:
    """Features in the frame of a leg, (..., f), of the mirror image of a walk."""
    channels = _channels(seen)
    order = np.array([0, 1, *(2 + -foot % N_LEGS for foot in range(channels - 2))])
    signs = np.array([1.0, -1.0, *([1.0] * (channels - 2))], dtype=features.dtype)
    patterns = features[..., : PARTS * channels].reshape(*features.shape[:-1], channels, PARTS)
    flipped = (patterns * signs[:, np.newaxis])[..., order, :].reshape(*features.shape[:-1], -1)
    return np.concatenate([flipped, features[..., PARTS * channels :]], axis=-1)


def learned(some: Examples, seen: str) -> LegSignatures:
    """Signatures learned from examples: the mean of several networks."""
    each = [_network(some, seen, seed) for seed in range(NETWORKS)]
    outputs = [one.outputs[:-1] for one in each] + [sum(one.outputs[-1:] for one in each)]
    joined = {
        name: np.concatenate([getattr(one, name) for one in each]) for name in ("patterns", "sizes", "biases")
    }
    return LegSignatures(**joined, outputs=np.concatenate(outputs) / NETWORKS)


def _network(some: Examples, seen: str, seed: int) -> LegSignatures:
    random = np.random.default_rng(seed)
    flat = some.features.reshape(-1, some.features.shape[-1])
    mean, scale = flat.mean(axis=0), np.maximum(flat.std(axis=0), 0.2)
    width = flat.shape[-1]
    weights: list[FloatArray] = [
        random.normal(0, 1 / math.sqrt(width), (width, UNITS)),
        np.zeros(UNITS),
        random.normal(0, 0.3 / math.sqrt(UNITS), UNITS),
        np.array([-2.0]),
    ]
    weights = [each.astype(np.float32) for each in weights]
    adam = Adam(weights, steps=PASSES * (len(some.legs) // BATCH))
    for _ in range(PASSES):
        order = random.permutation(len(some.legs))
        for first in range(0, len(order) - BATCH + 1, BATCH):
            at = order[first : first + BATCH]
            adam.step(_gradients(weights, (some.features[at] - mean) / scale, some.legs[at]))
    return _signatures(weights, mean, scale, seen)


def _gradients(weights: list[FloatArray], features: FloatArray, legs: NDArray[np.int64]) -> list[FloatArray]:
    """Gradients of the mean negative log likelihood."""
    inner, bias, outer, offset = weights
    flat = features.reshape(-1, features.shape[-1])
    units = np.tanh(flat @ inner + bias)
    odds = (units @ outer + offset).reshape(-1, N_LEGS)
    shares = np.exp(odds - np.maximum(odds.max(axis=-1, keepdims=True), 0.0))
    shares /= shares.sum(axis=-1, keepdims=True) + np.exp(-np.maximum(odds.max(axis=-1, keepdims=True), 0.0))
    off = (shares - (legs[:, np.newaxis] == np.arange(1, N_LEGS + 1))).reshape(-1).astype(np.float32)
    off /= len(legs)
    back = off[:, np.newaxis] * outer * (1 - units * units)
    return [flat.T @ back, back.sum(axis=0), units.T @ off, off.sum(keepdims=True)]


class Adam:
    """Adam with weight decay and a cosine rate (D. Kingma and J. Ba, ICLR 2015); changes weights in place."""

    def __init__(self, weights: list[FloatArray], steps: int) -> None:
        self._weights, self._steps, self._step = weights, steps, 0
        self._means = [np.zeros_like(each) for each in weights]
        self._squares = [np.zeros_like(each) for each in weights]

    def step(self, gradients: list[FloatArray]) -> None:
        """One step down the gradients."""
        rate = RATE * 0.5 * (1 + math.cos(math.pi * self._step / self._steps))
        self._step += 1
        for weight, mean, square, raw in zip(
            self._weights, self._means, self._squares, gradients, strict=True
        ):
            gradient = raw + DECAY * weight
            mean += 0.1 * (gradient - mean)
            square += 0.001 * (gradient**2 - square)
            size = np.sqrt(square / (1 - 0.999**self._step)) + 1e-8
            weight -= rate * mean / (1 - 0.9**self._step) / size


def _signatures(weights: list[FloatArray], mean: FloatArray, scale: FloatArray, seen: str) -> LegSignatures:
    """Signatures that average the network over a walk and its mirror image."""
    inner, bias, outer, offset = (each.astype(float) for each in weights)
    scaled = inner / scale[:, np.newaxis]
    both = np.concatenate([scaled.T, mirrored(scaled.T, seen)])
    cut = PARTS * _channels(seen)
    return LegSignatures(
        patterns=both[:, :cut].reshape(len(both), -1, PARTS),
        sizes=both[:, cut:],
        biases=np.tile(bias - mean @ scaled, 2),
        outputs=np.concatenate([outer / 2, outer / 2, offset]),
    )


def looks_of(batch: Batch, walks: list[LearningWalk], folder: Path) -> Looks:
    """Looks of a batch, simulated unless the folder has them."""
    file = folder / batch.name
    if not file.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(file, **observed(walks))  # type: ignore[arg-type]
    with np.load(file) as found:
        return dict(found)


def build(path: Path, folder: Path, batches: tuple[Batch, ...] = BATCHES) -> None:
    """Simulate, learn and write the signatures."""
    found = []
    for batch in batches:
        walks = walks_of(batch)
        found.append((walks, looks_of(batch, walks, folder)))
        print(batch.name, len(walks), flush=True)
    signatures = {seen: learned(examples(found, seen), seen) for seen in SENSORS}
    save_signatures(path, signatures, {"batches": [asdict(batch) for batch in batches]})


if __name__ == "__main__":
    build(Path(sys.argv[1]), Path(sys.argv[2]))
