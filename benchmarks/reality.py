"""The ledger of reality: published measurements against hexctl's values; `python -m benchmarks.reality`.

With --save it writes the table of docs/results/reality.md. Measured files are read from ../shared/data next
to the checkout, or from $HEXCTL_REALITY; items without their file are skipped. An item may be red.
"""

import json
import os
import sys
import tarfile
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.results import put, results
from benchmarks.rows import Bar
from hexctl.backends.sim.world import World, load_randomization, load_world
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.telemetry_watch import Temperatures
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.identify.bench_run import BenchRun, fit_bench, hinge_model, read_bench_run
from hexctl.identify.fit import mean_errors_rad
from hexctl.identify.parameters import ServoValues
from hexctl.identify.powered_servos import PoweredServos
from hexctl.robot.loader import load_robot

DATA = Path(os.environ.get("HEXCTL_REALITY", Path(__file__).parents[2] / "shared" / "data"))

#: Table of the documentation.
TABLE = "reality"

#: P gain at which the STS3215 of lukas is described.
STS_P_GAIN = 32

#: Shuffles the runs of the STS3215: those of the first 80 were fitted, the others are judged.
SHUFFLE, FITTED = 42, 80

#: Worlds of `real` in which open-loop walks are compared; of no other use.
WORLDS = range(7000, 7030)

#: Stiffness of the robots that the multiples of `real` are for, as its file says: 15 to 18.
NOMINAL_STIFFNESS_NM_PER_RAD = 16.5


@dataclass(frozen=True, slots=True)
class Item:
    """One published measurement.

    Attributes:
        bar: range around the measurement in which hexctl's value, in the same unit, agrees with it.
    """

    source: str
    unit: str
    bar: Bar
    value: Callable[[], float]

    def cells(self, value: float) -> dict[str, str]:
        """Return the cells of a value in the table of the documentation."""
        return {"hexctl": f"{value:.3g}{self.unit}", "agrees": "yes" if self.bar.holds(value) else "**no**"}


def near(low: float, high: float) -> Bar:
    """Return the bar of a measured range: 5 % wider."""
    return Bar(0.95 * low, 1.05 * high)


def _archive(name: str) -> Iterator[tuple[str, bytes]]:
    """Names and contents of an archive's files, by name; raises FileNotFoundError."""
    with tarfile.open(DATA / name) as archive:
        for member in sorted(archive.getmembers(), key=lambda one: one.name):
            file = archive.extractfile(member) if member.isfile() else None
            if file is not None:
                yield Path(member.name).name, file.read()


def _bench_runs(archive: str) -> list[BenchRun]:
    with tempfile.TemporaryDirectory() as folder:
        runs = []
        for name, content in _archive(archive):
            path = Path(folder) / name
            path.write_bytes(content)
            runs.append(read_bench_run(path))
    return runs


def lukas_servo() -> ServoValues:
    """The servo of lukas, with its stiffness per unit of the P gain."""
    values = ServoValues.of(load_robot("lukas"))
    return replace(values, stiffness_nm_per_rad=values.stiffness_nm_per_rad / STS_P_GAIN)


def _mean_deg(runs: list[BenchRun], values: ServoValues) -> float:
    return float(np.degrees(np.mean(list(mean_errors_rad(runs, values).values()))))


def sts3215_judged_runs() -> list[BenchRun]:
    """Runs of an STS3215 that were not fitted; raises FileNotFoundError without the measured files."""
    runs = _bench_runs("sts3215_12v_160.tar.xz")
    order = np.random.default_rng(SHUFFLE).permutation(len(runs))
    return [runs[index] for index in order[FITTED:]]


def sts3215_error_deg() -> float:
    """Mean error of the servo of lukas on runs that were not fitted."""
    return _mean_deg(sts3215_judged_runs(), lukas_servo())


def xl330_error_deg() -> float:
    """Mean error on every other run of a servo that was identified on the rest."""
    runs = _bench_runs("xl330_12.tar.xz")
    return _mean_deg(runs[1::2], fit_bench(runs[::2]).values)


def sts3215_no_load_deg_s() -> float:
    """Steady speed of the servo of lukas without load, with friction."""
    return _no_load_deg_s(ServoValues.of(load_robot("lukas")))


def ax12a_no_load_deg_s() -> float:
    """Steady speed of the servo of phantomx-ax without load, with friction."""
    return _no_load_deg_s(ServoValues.of(load_robot("phantomx-ax")))


def _no_load_deg_s(values: ServoValues) -> float:
    damping = values.back_emf_nm_s_per_rad + values.gear_damping_nm_s_per_rad
    return float(np.degrees((values.max_torque_nm - values.dry_friction_nm) / damping))


def ax12a_overshoot_deg(bar_kg_m2: float) -> float:
    """Overshoot of a step of 500 counts (146.6 degrees) with a balanced bar."""
    values = ServoValues.of(load_robot("phantomx-ax"))
    model = hinge_model(0.1, 0.0, bar_kg_m2 + 1e-6)
    data, goal_rad, angles = mujoco.MjData(model), np.radians(500 * 300 / 1023), []
    at_once = replace(values, dead_time_s=0.0)
    servos = PoweredServos(model, slice(0, 1), at_once, values.stiffness_nm_per_rad)
    data.ctrl[0] = goal_rad
    for _ in range(1000):
        servos.step(data, 1)
        angles.append(float(data.qpos[0]))
    return float(np.degrees(max(angles) - angles[-1]))


def play_outside() -> float:
    """Measured plays of hips and knees of lukas that the family `real` does not draw, as a number."""
    measured = json.loads((DATA / "lukas_measured.json").read_text())
    hips = {leg: one for leg, one in measured["hip_hysteresis_deg_per_leg"].items() if leg != "note"}
    plays = [*hips.values(), *measured["knee_hysteresis_deg"].values()]
    spread = load_randomization("real").ranges["servo_backlash_deg"]
    return float(sum(not spread.low <= play <= spread.high for play in plays))


def lukas_worlds() -> list[World]:
    """Worlds of `real` with the stiffnesses and dead times that they have for robots with assumed servos.

    Those of lukas are identified, and are no base for the multiples of the family.
    """
    servo = load_robot("lukas").servo
    share = NOMINAL_STIFFNESS_NM_PER_RAD / servo.stiffness_nm_per_rad
    drawn = [load_world(f"real:{number}") for number in WORLDS]
    return [
        world.model_copy(
            update={
                "servo_stiffness": share * world.servo_stiffness,
                "servo_delay_s": max(world.servo_delay_s - servo.dead_time_s, 0.0),
            }
        )
        for world in drawn
    ]


def settled_error_deg() -> float:
    """90th percentile of the error of lukas's joints after standing for two seconds in worlds of `real`."""
    from hexctl.backends.sim.servos import SimServos
    from hexctl.types import JointTargets

    errors = []
    for world in lukas_worlds()[:10]:
        with SimServos(load_robot("lukas"), world=world) as servos:
            target_rad = servos.robot.stance_angles_rad
            for _ in range(100):
                servos.write(JointTargets(target_rad, servos.clock.now_s))
                servos.clock.tick()
            errors.append(np.degrees(np.abs(servos.read().joint_positions_rad - target_rad)))
    return float(np.quantile(np.concatenate(errors), 0.9))


@cache
def open_loop_walks() -> list[tuple[float, float]]:
    """Share of the commanded way and turn in degrees of open-loop tripods of lukas, 30 s in each world."""
    robot = load_robot("lukas")
    plan = TrialPlan(gait=make_gait(robot, "tripod"), duration_s=30.0, hold="none", self_rotation="none")
    trials = [SimTrial(robot=robot, plan=plan, failures=None, world=world) for world in lukas_worlds()]
    return [
        ((one.distance_m or 0.0) / one.ideal_distance_m, float(np.degrees(one.yaw_change_rad or 0.0)))
        for one in run_sim_trials(trials)
    ]


def travel_share(quantile: float) -> float:
    """Quantile of the share of the commanded way in open loop."""
    return float(np.quantile([share for share, _ in open_loop_walks()], quantile))


def greatest_turn_deg() -> float:
    """Greatest turn in open loop."""
    return max(abs(turn_deg) for _, turn_deg in open_loop_walks())


def believed_c() -> float:
    """Temperature that is believed after 31, 142 and 31 degrees within a second."""
    watch, believed = Temperatures(), np.zeros(1)
    for tick in range(100):
        reading_c = 142.0 if 50 <= tick < 80 else 31.0
        believed = watch.take(np.array([reading_c]), 0.02 * tick)
    return float(believed[0])


#: Items by their rows in docs/results/results.yaml, which have names and measured values.
ITEMS = {
    "sts3215_pendulum": Item("kscalelabs/sysid, 80 runs not fitted", "°", Bar(high=2.0), sts3215_error_deg),
    "xl330_pendulum": Item("Rhoban/bam", "°", Bar(high=1.8), xl330_error_deg),
    "sts3215_speed": Item("data sheet", " deg/s", near(270, 270), sts3215_no_load_deg_s),
    "ax12a_speed": Item("treydufrene/meiosis_dev, 6 steps", " deg/s", near(390, 415), ax12a_no_load_deg_s),
    "ax12a_overshoot": Item(
        "treydufrene/meiosis_dev, 146°", "°", near(5.6, 6.2), lambda: ax12a_overshoot_deg(0.0)
    ),
    "ax12a_overshoot_bar": Item(
        "treydufrene/meiosis_dev, 146°, bar of 0.0046 kg m²",
        "°",
        near(8.7, 8.9),
        lambda: ax12a_overshoot_deg(0.146 * (0.613**2 + 0.019**2) / 12),
    ),
    "play": Item("lukas/hexapod, 9 joints", "", Bar(high=0), play_outside),
    "settled": Item("lukas/hexapod", "°", Bar(0.06, 0.73), settled_error_deg),
    "distance_min": Item("lukas/hexapod, robot 1", "", Bar(high=0.29), lambda: travel_share(0.0)),
    "distance_max": Item("lukas/hexapod, robot 2", "", Bar(low=0.70), lambda: travel_share(1.0)),
    "turn": Item("lukas/hexapod, robot 2, one walk", "°", Bar(low=60), greatest_turn_deg),
    "temperature": Item("lukas/hexapod, 31, 142, 31 °C within a second", " °C", Bar(high=40), believed_c),
}


def main(*, save: bool) -> None:
    """Print the ledger, and write it into the documentation if asked to."""
    rows, cells = results()[TABLE]["rows"], dict[str, str]()
    for key, item in ITEMS.items():
        try:
            value = item.value()
        except FileNotFoundError:
            print(f"skipped  {rows[key]['name']}: no data folder")
            continue
        cells |= {f"{TABLE}.{key}.{column}": text for column, text in item.cells(value).items()}
        verdict = "held" if item.bar.holds(value) else "RED"
        against = f"measured {rows[key]['measured']} ({item.source}); hexctl {value:.4g}{item.unit}"
        print(f"{verdict:8} {rows[key]['name']}: {against}", flush=True)
    if save:
        put(cells)


if __name__ == "__main__":
    main(save="--save" in sys.argv)
