"""Friction that grows with the load: of a servo on a bench, and of one robot and many alike."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulated_batch import SimBatch
from hexctl.identify.bench_run import BenchRun
from hexctl.identify.parameters import ServoValues
from hexctl.robot.failure import Failure, FailureEvent
from hexctl.robot.model import Robot
from hexctl.testing.servo_conformance import move
from hexctl.types import JointTargets
from tests.robots import shipped

DRY_NM, STALL_NM, STIFFNESS = 0.02, 2.0, 4.0


def rubbing(share: float) -> Robot:
    robot = shipped("lukas")
    return replace(robot, servo=replace(robot.servo, load_friction=share))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_a_motor_that_slowly_raises_and_lowers_a_mass_balances_it_and_its_gears(share: float) -> None:
    time_s = np.arange(0.0, 20.0, 0.02)
    goal_rad = 0.9 - np.abs(0.9 - 0.09 * time_s)
    run = BenchRun("slow", 0.6, 0.12, 0.0, 1.0, time_s, goal_rad, 0 * time_s, time_s >= 0)
    values = ServoValues(
        stiffness_nm_per_rad=STIFFNESS,
        damping_nm_s_per_rad=1e-4,
        rotor_inertia_kg_m2=0.005,
        dry_friction_nm=DRY_NM,
        load_friction=share,
        gear_damping_nm_s_per_rad=0.05,
        max_torque_nm=STALL_NM,
        no_load_speed_rad_s=1e6,
        dead_time_s=0.0,
    )
    angles_rad = run.errors_rad(values)
    for at_s, way in ((7.0, 1), (9.0, 1), (13.0, -1), (15.0, -1)):
        row = int(at_s / 0.02)
        motor_nm = STIFFNESS * (goal_rad[row] - angles_rad[row])
        lost_nm = DRY_NM + share * motor_nm * (1 + motor_nm / STALL_NM) / 2
        load_nm = 0.6 * 9.81 * 0.12 * np.sin(angles_rad[row])
        assert motor_nm - way * lost_nm == pytest.approx(load_nm, abs=0.012)


def test_servos_without_power_keep_the_dry_friction() -> None:
    with SimServos(rubbing(0.4)) as servos:
        move(servos, servos.robot.stance_angles_rad + 0.05, ticks=20)
        model, dry_nm = servos.compiled.physics.model, servos.robot.dry_friction_nm
        assert (model.dof_frictionloss[6:] > dry_nm).all()
        servos.disable_torque()
        servos.clock.tick()
        np.testing.assert_array_equal(model.dof_frictionloss[6:], dry_nm)


def test_a_batch_of_worlds_with_events_equals_its_single_robots() -> None:
    """Copies that are told different things rub differently, and a leg that fails changes no friction."""
    event = FailureEvent(at_s=0.1, leg=2, failure=Failure(leg=2, kind="missing"))

    def begun(world: str, events: tuple[FailureEvent, ...]) -> SimServos:
        servos = SimServos(rubbing(0.5), world=world, events=events)
        servos.connect()
        move(servos, servos.robot.stance_angles_rad + 0.05, ticks=5)
        servos.walk_begins()
        return servos

    kinds = [("flat", (event,)), ("slippery", ())]
    stance_rad, waves = shipped("lukas").stance_angles_rad, (0.05, 0.1)
    batch = SimBatch([begun(*kind) for kind in kinds], [2, 2])
    alone = [(begun(*kind), size) for kind in kinds for size in waves]
    for tick in range(12):
        wave = np.sin(0.6 * tick)
        batch.write(np.array([stance_rad + size * wave for _ in kinds for size in waves]))
        batch.tick()
        for servos, size in alone:
            servos.write(JointTargets(stance_rad + size * wave, 0.0))
            servos.clock.tick()
    states = [servos.read().joint_positions_rad for servos, _ in alone]
    np.testing.assert_array_equal(batch.read().joint_positions_rad, states)
