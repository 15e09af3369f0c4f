"""Runs of one servo on a bench: it swings a mass on a bar, as the files of BAM and of others record it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hexctl.errors import InputError
from hexctl.files import read_file
from hexctl.identify.fit import ROUGH_GAIN, Fit, OnStage, fit_values
from hexctl.identify.parameters import OF_SERVO, PARAMETERS, ServoValues
from hexctl.identify.powered_servos import PoweredServos
from hexctl.robot.configs import validate
from hexctl.robot.model import STICTION
from hexctl.robot.plausibility import bench_problem
from hexctl.types import ArrayFields, BoolArray, FloatArray

#: Step of the physics, that of hexctl's simulations, and samples for the longest dead time.
STEP_S, DELAY_SAMPLES = 0.002, 32

#: Friction that grows with the load: start of its search, and the share of the error that it must explain.
LOAD_FRICTION, FIRST_SHARE, LEAST_GAIN = "load_friction", 0.3, 0.1

#: A file as large as an hour at 200 Hz.
MOST_BYTES = 200_000_000

#: Keys of a file, for messages.
KEYS = "mass, length, kp, and entries of timestamp, position, goal_position"

Above0 = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True)

    timestamp: Finite
    position: Finite
    goal_position: Finite
    torque_enable: bool = True


class _BenchFile(BaseModel):
    """What a file of a run holds; further keys are left alone."""

    model_config = ConfigDict(frozen=True)

    mass: Above0
    length: Above0
    kp: Above0
    arm_mass: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    entries: Annotated[list[_Entry], Field(min_length=10)]


@dataclass(frozen=True, slots=True, eq=False)
class BenchRun(ArrayFields):
    """One run of a servo, angle 0 with the bar hanging; arrays of shape (T,).

    Attributes:
        mass_kg: at the end of the bar of `length_m` and `bar_kg`.
        p_gain: of the servo's firmware; the stiffness is proportional to it.
        powered: whether torque was on.
    """

    name: str
    mass_kg: float
    length_m: float
    bar_kg: float
    p_gain: float
    time_s: FloatArray
    goal_rad: FloatArray
    measured_rad: FloatArray
    powered: BoolArray
    units: ClassVar[int] = 1

    @property
    def parameters(self) -> tuple[str, ...]:
        """All of a servo."""
        return OF_SERVO

    def errors_rad(self, values: ServoValues) -> FloatArray:
        """Simulated less measured angles, (T,); `values` have the stiffness per unit of P gain."""
        import mujoco

        model = hinge_model(*self._body)
        data = mujoco.MjData(model)
        servos = PoweredServos(model, slice(0, 1), values, values.stiffness_nm_per_rad * self.p_gain)
        data.qpos[0], data.ctrl[0] = self.measured_rad[0], self.goal_rad[0]
        mujoco.mj_initCtrlHistory(model, data, 0, None, np.full((DELAY_SAMPLES, 1), self.goal_rad[0]))
        angles_rad, at_step = np.empty(len(self.time_s)), np.rint(self.time_s / STEP_S).astype(int)
        for row, steps in enumerate(np.diff(at_step, append=at_step[-1]).tolist()):
            angles_rad[row] = data.qpos[0]
            if bool(self.powered[row]) != servos.on:
                servos.switch(on=not servos.on)
            data.ctrl[0] = self.goal_rad[row]
            servos.step(data, steps)
        return angles_rad - self.measured_rad

    @property
    def _body(self) -> tuple[float, float, float]:
        """Mass, distance of its centre from the axis, and inertia about the centre."""
        kg = self.mass_kg + self.bar_kg
        centre_m = (self.mass_kg + self.bar_kg / 2) * self.length_m / kg
        about_axis = (self.mass_kg + self.bar_kg / 3) * self.length_m**2
        return kg, centre_m, max(about_axis - kg * centre_m**2, 1e-6)


def hinge_model(kg: float, centre_m: float, inertia_kg_m2: float) -> Any:
    """MuJoCo model of a servo: a hinge with a mass, whose centre is below it; its values are set later."""
    import mujoco

    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP_S}" integrator="implicitfast"/><worldbody><body>'
        f'<joint name="servo" type="hinge" axis="0 1 0" frictionloss="0.1" '
        f'solimpfriction="{" ".join(map(str, STICTION))}"/><inertial pos="0 0 {-centre_m}" mass="{kg}" '
        f'diaginertia="{inertia_kg_m2} {inertia_kg_m2} {1e-6}"/></body></worldbody><actuator>'
        '<position joint="servo" kp="1" kv="0.1" forcelimited="true" forcerange="-1 1" '
        f'delay="{(DELAY_SAMPLES - 2) * STEP_S}" nsample="{DELAY_SAMPLES}"/></actuator></mujoco>'
    )


def read_bench_run(path: Path) -> BenchRun:
    """Run of a JSON file with `mass`, `length`, `kp` and `entries`; raises InputError with the damage."""
    try:
        content: Any = json.loads(read_file(path, MOST_BYTES))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not valid JSON: {error}; allowed: a run with {KEYS}") from error
    try:
        parsed = validate(_BenchFile, content, path)
    except InputError as error:
        raise InputError(f"{error}; a run has {KEYS}") from error
    rows = np.array([(one.timestamp, one.goal_position, one.position) for one in parsed.entries])
    time_s = rows[:, 0] - rows[0, 0]
    if (np.diff(time_s) <= 0).any():
        raise InputError(f"{path}: entries.timestamp: got times that do not grow; allowed: growing times")
    if problem := bench_problem(parsed.mass + parsed.arm_mass, parsed.length, rows[:, 1:], time_s):
        raise InputError(f"{path}: {problem}")
    return BenchRun(
        name=path.name,
        mass_kg=parsed.mass,
        length_m=parsed.length,
        bar_kg=parsed.arm_mass,
        p_gain=parsed.kp,
        time_s=time_s,
        goal_rad=rows[:, 1],
        measured_rad=rows[:, 2],
        powered=np.array([one.torque_enable for one in parsed.entries]),
    )


def plain_start(runs: Sequence[BenchRun]) -> ServoValues:
    """Values from which the search for an unknown servo starts: from the load that it held."""
    load_nm = max(9.81 * run.length_m * (run.mass_kg + run.bar_kg / 2) for run in runs)
    most_gain = max(run.p_gain for run in runs)
    inertia_kg_m2 = float(np.median([run.length_m**2 * run.mass_kg for run in runs]))
    return ServoValues(
        stiffness_nm_per_rad=10 * load_nm / most_gain,
        damping_nm_s_per_rad=0.1 * load_nm,
        rotor_inertia_kg_m2=inertia_kg_m2,
        dry_friction_nm=0.05 * load_nm,
        load_friction=0.0,
        gear_damping_nm_s_per_rad=0.02 * load_nm,
        max_torque_nm=2 * load_nm,
        no_load_speed_rad_s=6.0,
        dead_time_s=0.01,
    )


def fit_bench(
    runs: Sequence[BenchRun], on_step: OnStage = lambda _stage, _step, _error_rad: None
) -> Fit[ServoValues]:
    """Values of a servo that explain runs; its friction grows with the load only where they show it."""
    without, starts = [name for name in OF_SERVO if name != LOAD_FRICTION], _starts(runs)
    rough = [
        fit_values(
            runs,
            start,
            without,
            enough_gain=ROUGH_GAIN,
            on_step=partial(on_step, f"start {number} of {len(starts)}"),
        )
        for number, start in enumerate(starts, 1)
    ]
    best = min(rough, key=_error_rad).values
    plain = fit_values(runs, best, without, on_step=partial(on_step, "best start"))
    start = replace(plain.values, load_friction=FIRST_SHARE)
    loaded = fit_values(runs, start, OF_SERVO, on_step=partial(on_step, "with friction under load"))
    if _error_rad(loaded) < (1 - LEAST_GAIN) * _error_rad(plain):
        return replace(loaded, before_rad=rough[0].before_rad)
    none = PARAMETERS[LOAD_FRICTION].estimate(0.0, loaded.estimates[LOAD_FRICTION].deviation)
    return replace(plain, estimates={**plain.estimates, LOAD_FRICTION: none}, before_rad=rough[0].before_rad)


def _starts(runs: Sequence[BenchRun]) -> list[ServoValues]:
    """Slow and fast servos with much and little inertia: a search ends near where it starts."""
    plain = plain_start(runs)
    return [
        replace(plain, rotor_inertia_kg_m2=share * plain.rotor_inertia_kg_m2, no_load_speed_rad_s=speed_rad_s)
        for share in (1.0, 0.3)
        for speed_rad_s in (6.0, 15.0)
    ]


def _error_rad(fit: Fit[ServoValues]) -> float:
    return sum(fit.after_rad.values())
