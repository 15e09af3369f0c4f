"""The ledger of reality: published measurements against hexctl's values; `python -m benchmarks.reality`.

Measured files are read from ../shared/data beside the checkout, or from $HEXCTL_REALITY; items without their
file are skipped. Held or not: an item may be red.
"""

import json
import os
import tarfile
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.rows import Bar
from hexctl.backends.sim.world import load_randomization, load_world
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.telemetry_watch import BatteryWatch, Temperatures
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.identify.bench_run import BenchRun, fit_bench, hinge_model, read_bench_run
from hexctl.identify.fit import mean_errors_rad
from hexctl.identify.parameters import ServoValues
from hexctl.identify.powered_servos import PoweredServos
from hexctl.robot.loader import load_robot, load_robot_file
from hexctl.robot.servos.bus_map import bus_map_of

DATA = Path(os.environ.get("HEXCTL_REALITY", Path(__file__).parents[2] / "shared" / "data"))

#: P gain at which the STS3215 of lukas is described.
STS_P_GAIN = 32

#: Shuffles the runs of the STS3215: those of the first 80 were fitted, the others are judged.
SHUFFLE, FITTED = 42, 80

#: Worlds of `real` in which open-loop walks are compared; of no other use.
WORLDS = range(7000, 7030)


@dataclass(frozen=True, slots=True)
class Item:
    """One published measurement.

    Attributes:
        measured: the published value, as text.
        value: hexctl's value, in the unit of the bar.
        bar: in which hexctl's value agrees with the measurement.
    """

    name: str
    source: str
    measured: str
    unit: str
    bar: Bar
    value: Callable[[], float]


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


def settled_error_deg() -> float:
    """90th percentile of the error of lukas's joints after standing for two seconds in worlds of `real`."""
    from hexctl.backends.sim.servos import SimServos
    from hexctl.types import JointTargets

    errors = []
    for number in WORLDS[:10]:
        with SimServos(load_robot("lukas"), world=f"real:{number}") as servos:
            target_rad = servos.robot.stance_angles_rad
            for _ in range(100):
                servos.write(JointTargets(target_rad, servos.clock.now_s))
                servos.clock.tick()
            errors.append(np.degrees(np.abs(servos.read().joint_positions_rad - target_rad)))
    return float(np.quantile(np.concatenate(errors), 0.9))


def open_loop_walks() -> list[tuple[float, float]]:
    """Share of the commanded way and turn in degrees of open-loop tripods of lukas, 30 s in each world."""
    robot = load_robot("lukas")
    plan = TrialPlan(gait=make_gait(robot, "tripod"), duration_s=30.0, hold="none", self_rotation="none")
    trials = [
        SimTrial(robot=robot, plan=plan, failure=None, world=load_world(f"real:{number}"))
        for number in WORLDS
    ]
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


def sits_at_11_1_v() -> float:
    """1 if a battery that dips to 11.1 V in strides makes the robot sit, else 0."""
    watch = BatteryWatch()
    least_v = bus_map_of(load_robot_file("lukas").content.servos, "feetech").low_battery_v
    return float(any(watch.low(11.1 if tick % 3 else 11.9, least_v, 0.1 * tick) for tick in range(200)))


ITEMS = (
    Item(
        "STS3215 pendulum",
        "kscalelabs/sysid, 80 runs not fitted",
        "angles at 100 Hz",
        "deg",
        Bar(high=2.0),
        sts3215_error_deg,
    ),
    Item("XL330 pendulum", "Rhoban/bam", "angles; BAM's best: 1.77", "deg", Bar(high=1.8), xl330_error_deg),
    Item(
        "STS3215 rotor inertia",
        "three identifications",
        "0.022 to 0.033",
        "kg m2",
        Bar(0.022, 0.033),
        lambda: load_robot("lukas").servo.rotor_inertia_kg_m2,
    ),
    Item(
        "STS3215 stall torque",
        "data sheet, 12 V",
        "2.94",
        "N m",
        Bar(2.8, 3.1),
        lambda: float(load_robot("lukas").joint_max_torque_nm[0]),
    ),
    Item("STS3215 speed without load", "data sheet", "270", "deg/s", Bar(257, 284), sts3215_no_load_deg_s),
    Item(
        "AX-12A speed without load",
        "treydufrene/meiosis_dev, 6 steps",
        "390 to 415",
        "deg/s",
        Bar(390, 415),
        ax12a_no_load_deg_s,
    ),
    Item(
        "AX-12A overshoot with a bar",
        "the same, bar of 0.0046 kg m2",
        "8.7 to 8.9 of 146",
        "deg",
        Bar(5, 10),
        lambda: ax12a_overshoot_deg(0.146 * (0.613**2 + 0.019**2) / 12),
    ),
    Item(
        "AX-12A overshoot without load",
        "the same",
        "5.6 to 6.2 of 146",
        "deg",
        Bar(5, 7),
        lambda: ax12a_overshoot_deg(0.0),
    ),
    Item(
        "play of hips and knees",
        "lukas/hexapod, 9 joints",
        "0.26 to 0.97 deg",
        "outside real",
        Bar(high=0),
        play_outside,
    ),
    Item(
        "settled error",
        "lukas/hexapod",
        "0.06 to 0.73; 90 % below",
        "deg",
        Bar(0.3, 1.5),
        settled_error_deg,
    ),
    Item(
        "least travelled way in open loop",
        "lukas/hexapod, robot 1",
        "0.29 of the commanded",
        "share",
        Bar(high=0.29),
        lambda: travel_share(0.0),
    ),
    Item(
        "most travelled way in open loop",
        "lukas/hexapod, robot 2",
        "0.70 of the commanded",
        "share",
        Bar(low=0.70),
        lambda: travel_share(1.0),
    ),
    Item(
        "greatest turn in open loop",
        "lukas/hexapod, robot 2",
        "60 in one walk",
        "deg",
        Bar(low=60),
        greatest_turn_deg,
    ),
    Item(
        "spike of a temperature",
        "lukas/hexapod",
        "31, 142, 31 C within a second",
        "C believed",
        Bar(high=40),
        believed_c,
    ),
    Item(
        "voltage dips of a walk",
        "lukas/hexapod",
        "11.1 V at least, no brown-out",
        "sits",
        Bar(high=0),
        sits_at_11_1_v,
    ),
)


def main() -> None:
    """Print the ledger."""
    held = judged = 0
    for item in ITEMS:
        try:
            value = item.value()
        except FileNotFoundError:
            print(f"skipped  {item.name}: no data folder")
            continue
        judged, held = judged + 1, held + item.bar.holds(value)
        verdict = "held" if item.bar.holds(value) else "RED"
        against = f"measured {item.measured} ({item.source}); hexctl {value:.4g} {item.unit}"
        print(f"{verdict:8} {item.name}: {against}", flush=True)
    print(f"{held} of {judged} held")


if __name__ == "__main__":
    main()
