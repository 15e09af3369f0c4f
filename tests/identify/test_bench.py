"""Runs of one servo on a bench: the servo that made them is found again, and damaged files are refused."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from hexctl.identify.bench_run import BenchRun, fit_bench, plain_start, read_bench_run
from hexctl.identify.fit import fit_values
from hexctl.identify.identification import Identification, identify
from hexctl.identify.parameters import Estimate, ServoValues
from hexctl.types import JOINTS_PER_LEG, N_LEGS, FloatArray

TRUTH = ServoValues(
    stiffness_nm_per_rad=0.8,
    damping_nm_s_per_rad=0.5,
    rotor_inertia_kg_m2=0.02,
    dry_friction_nm=0.12,
    load_friction=0.0,
    gear_damping_nm_s_per_rad=0.03,
    max_torque_nm=3.0,
    no_load_speed_rad_s=5.0,
    dead_time_s=0.014,
)

SEARCHED = ("stiffness_nm_per_rad", "rotor_inertia_kg_m2", "dry_friction_nm", "dead_time_s")


def bench_run(
    seed: int, *, p_gain: float = 16.0, duration_s: float = 4.0, truth: ServoValues = TRUTH
) -> BenchRun:
    """A run of the true servo: waves and steps, read with the counts of an encoder."""
    draw = np.random.default_rng(seed)
    time_s = np.arange(0.0, duration_s, 0.01)
    wave = 0.6 * np.sin(2 * np.pi * draw.uniform(0.4, 1.2) * time_s)
    goal_rad = wave + 0.4 * np.sign(np.sin(2 * np.pi * draw.uniform(0.3, 0.6) * time_s))
    made = BenchRun(
        name=f"run{seed}",
        mass_kg=float(draw.uniform(0.5, 1.2)),
        length_m=0.12,
        bar_kg=0.05,
        p_gain=p_gain,
        time_s=time_s,
        goal_rad=goal_rad,
        measured_rad=np.zeros_like(time_s),
        powered=time_s < duration_s - 0.5,
    )
    count_rad = 2 * np.pi / 4096
    return replace(made, measured_rad=np.round(made.errors_rad(truth) / count_rad) * count_rad)


def write_run(path: Path, run: BenchRun, **changed: Any) -> Path:
    whole = {"mass": run.mass_kg, "length": run.length_m, "arm_mass": run.bar_kg, "kp": run.p_gain}
    rows = zip(run.time_s, run.goal_rad, run.measured_rad, run.powered, strict=True)
    entries = [
        {"timestamp": t, "goal_position": goal, "position": at, "torque_enable": bool(on)}
        for t, goal, at, on in rows
    ]
    path.write_text(json.dumps(whole | {"motor": "mine", "entries": entries} | changed))
    return path


@pytest.mark.slow
def test_the_servo_that_made_the_runs_is_found() -> None:
    runs = [bench_run(1), bench_run(2, p_gain=32.0)]
    start = plain_start(runs)
    start = replace(TRUTH, **{name: getattr(start, name) for name in SEARCHED})
    fit = fit_values(runs, start, SEARCHED)
    for name in SEARCHED:
        found, true = fit.estimates[name], getattr(TRUTH, name)
        assert found.known
        assert abs(found.value - true) < (0.001 if name == "dead_time_s" else 0.06 * true)
    assert max(fit.after_rad.values()) < np.radians(0.1)
    assert max(fit.before_rad.values()) > np.radians(0.5)


def test_a_servo_without_power_swings_freely() -> None:
    run = replace(bench_run(4), powered=np.zeros(400, dtype=bool), goal_rad=np.zeros(400))
    raised = replace(run, measured_rad=np.full(400, 1.0))
    angles_rad = raised.errors_rad(replace(TRUTH, dry_friction_nm=1e-4)) + 1.0
    assert angles_rad.min() < -0.5


def test_a_run_is_read_as_it_was_written(tmp_path: Path) -> None:
    run = bench_run(5, duration_s=1.0)
    read = read_bench_run(write_run(tmp_path / "run5.json", run))
    assert (read.mass_kg, read.bar_kg, read.p_gain) == (run.mass_kg, run.bar_kg, run.p_gain)
    np.testing.assert_allclose(read.measured_rad, run.measured_rad)
    np.testing.assert_array_equal(read.powered, run.powered)


def entries(*, t_s: float = 0.02, goal_rad: float = 0.5, at_rad: float = 0.4) -> list[dict[str, float]]:
    """Readings, by default of a servo at rest."""
    return [{"timestamp": n * t_s, "position": at_rad, "goal_position": goal_rad} for n in range(20)]


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"mass": -1}, "mass"),
        ({"length": None}, "length"),
        ({"kp": "soft"}, "kp"),
        ({"entries": []}, "entries"),
        ({"entries": [{"timestamp": 0.0}] * 20}, "entries"),
        ({"entries": [{"timestamp": 0.0, "position": 0.0, "goal_position": 0.0}] * 20}, "timestamp"),
        ({"arm_mass": float("nan")}, "arm_mass"),
        ({"mass": 600.0}, "mass: .*in g that is 0.6 kg"),
        ({"mass": 45.0, "length": 0.15}, "mass and length: .*in g that is 0.045 kg"),
        ({"length": 120.0}, "length: .*in mm that is 0.12 m"),
        ({"entries": entries(t_s=20.0)}, "timestamp: .*in ms that is 0.02 s"),
        ({"entries": [*entries(), {"timestamp": 1e9, "position": 0, "goal_position": 0}]}, "timestamp"),
        ({"entries": entries(goal_rad=-45.0)}, "goal_position: .*in deg that is 0.785 rad"),
        ({"entries": entries(at_rad=8.0)}, "position.*in deg that is 0.14 rad"),
        ({"entries": entries(at_rad=2048.0)}, "position.*in counts of 4096 that is 3.14 rad"),
    ],
)
def test_a_damaged_run_is_refused(changed: dict[str, Any], key: str, tmp_path: Path) -> None:
    path = write_run(tmp_path / "bad.json", bench_run(6, duration_s=0.5), **changed)
    with pytest.raises(InputError, match=key):
        read_bench_run(path)


@pytest.mark.parametrize("content", ["", "[1, 2]", '{"mass": 1', "[" * 100_000, '{"mass": 1}'])
def test_what_is_no_run_is_refused(content: str, tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"run\.json.*mass, length, kp, and entries"):
        read_bench_run(path)


@pytest.mark.parametrize("names", [[], ["a.json", "b.rrd"], ["a.txt"]])
def test_logs_of_other_kinds_are_refused(names: list[str]) -> None:
    with pytest.raises(InputError, match="LOG"):
        identify(names)


class Motions:
    """Motions whose errors are a formula of the values."""

    def __init__(
        self,
        errors_rad: Callable[[ServoValues], FloatArray],
        *parameters: str,
        units: int = 1,
        name: str = "motions",
    ) -> None:
        self.errors_rad, self.parameters, self.units, self.name = errors_rad, parameters, units, name

    def fitted(self, *more: "Motions") -> Mapping[str, Estimate]:
        return fit_values([self, *more], TRUTH, self.parameters).estimates


def test_a_parameter_without_effect_is_not_known() -> None:
    line = np.linspace(0.001, 0.01, 100)
    found = Motions(
        lambda values: (values.stiffness_nm_per_rad - 2.0) * line, "stiffness_nm_per_rad", "dry_friction_nm"
    ).fitted()
    stiffness, friction = found["stiffness_nm_per_rad"], found["dry_friction_nm"]
    assert stiffness.known
    assert stiffness.value == pytest.approx(2.0, rel=0.01)
    assert (friction.known, friction.to_dict()["deviation"]) == (False, None)


@pytest.mark.parametrize(("best_nm", "at_bound"), [(0.3, False), (-0.02, True)])
def test_a_value_at_its_bound_is_as_uncertain_as_one_within(best_nm: float, at_bound: bool) -> None:
    """Its error is that of the mean of 500 readings: 0.01 / sqrt(500) rad, a tenth of a change of it."""

    def noisy(seed: int) -> Motions:
        noise = np.random.default_rng(seed).normal(scale=0.01, size=50)
        return Motions(
            lambda values: 0.1 * (values.dry_friction_nm - best_nm) + noise,
            "dry_friction_nm",
            name=str(seed),
        )

    found = noisy(0).fitted(*map(noisy, range(1, 10)))["dry_friction_nm"]
    assert found.deviation == pytest.approx(0.1 / np.sqrt(500), rel=0.5)
    assert (found.value == 1e-4) == at_bound
    assert found.known != at_bound


def test_legs_that_differ_are_in_the_standard_error() -> None:
    legs_nm = np.array([0.1, 0.2, 0.2, 0.3, 0.3, 0.4])
    best_nm = np.repeat(legs_nm, JOINTS_PER_LEG)
    legs = Motions(
        lambda values: np.tile(0.01 * (values.dry_friction_nm - best_nm), (50, 1)),
        "dry_friction_nm",
        units=N_LEGS,
    )
    found = legs.fitted()["dry_friction_nm"]
    assert found.value == pytest.approx(0.25, rel=0.01)
    assert found.deviation == pytest.approx(np.std(legs_nm, ddof=1) / np.sqrt(6), rel=0.05)


def test_a_dead_time_may_lie_between_steps() -> None:
    run = bench_run(8, duration_s=2.0)
    run = replace(run, goal_rad=0.4 * np.sin(6 * run.time_s))
    early, middle, late = (
        run.errors_rad(replace(TRUTH, dead_time_s=dead_s)) for dead_s in (0.010, 0.011, 0.012)
    )
    assert np.abs(late - early).max() > np.radians(0.2)
    np.testing.assert_allclose(middle, (early + late) / 2, atol=np.radians(0.01))


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_friction_that_grows_with_the_load_is_found_where_there_is_some(share: float) -> None:
    truth = replace(TRUTH, load_friction=share)
    runs = [bench_run(1, duration_s=2.0, truth=truth), bench_run(2, p_gain=32.0, duration_s=2.0, truth=truth)]
    found = fit_bench(runs).estimates["load_friction"]
    assert found.known
    assert found.value == pytest.approx(share, abs=0.08)


def test_a_fit_that_is_worse_than_its_start_is_no_success_and_writes_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = bench_run(9, duration_s=0.5)
    log, output = write_run(tmp_path / "run.json", run), tmp_path / "out.yaml"
    command = ["identify", str(log), "--robot", "lukas", "--output", str(output)]
    fit = fit_values([run], TRUTH, ["stiffness_nm_per_rad"])
    for after_rad, code in ((0.0, 0), (2.0, 2)):
        output.unlink(missing_ok=True)
        output.with_suffix(".png").unlink(missing_ok=True)
        found = Identification(replace(fit, after_rad={run.name: after_rad}), {}, (run,), 16.0)
        monkeypatch.setattr("hexctl.identify.identification.identify", lambda *_, found=found, **__: found)
        assert exit_code(command) == code
        assert output.exists() == (code == 0)
