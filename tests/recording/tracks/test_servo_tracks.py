"""What a recording keeps of single servos: once a second, and only what is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from hexctl.control.log import COLUMN_NAMES, TickLog
from hexctl.control.table import ServoRows
from hexctl.recording import paths
from hexctl.types import FloatArray, ServoReadings
from tests.recording.conftest import ReadBack, Trial, write

UNKNOWN = np.full(18, np.nan)


def _readings(second: int) -> ServoReadings:
    """Servos that get warmer by a degree in a second; the last one tells nothing, and none its current."""
    temperatures_c: FloatArray = np.arange(30.0, 48.0) + second
    temperatures_c[-1] = np.nan
    return ServoReadings(
        ages_s=np.full(18, 0.016),
        efforts=UNKNOWN,
        currents_a=UNKNOWN,
        voltages_v=np.full(18, 11.75),
        temperatures_c=temperatures_c,
    )


def _with_servos(trial: Trial) -> Trial:
    log = TickLog()
    log.extend({name: trial.log[name] for name in COLUMN_NAMES})
    log.frame, log.contacts_known = trial.log.frame, trial.log.contacts_known
    log.servo_rows = ServoRows((row, _readings(row // 50)) for row in range(0, len(log), 50))
    return replace(trial, log=log)


def test_temperatures_and_voltages_are_drawn_once_a_second(trial: Trial, tmp_path: Path) -> None:
    with_servos = _with_servos(trial)
    read = ReadBack(write(tmp_path / "servos.rrd", with_servos, block_ticks=70))
    drawn = np.array(read.values(f"/{paths.TEMPERATURES}", "Scalars:scalars"), dtype=float)
    wanted = np.stack([servos.temperatures_c for _, servos in with_servos.log.servo_rows])
    np.testing.assert_allclose(drawn, wanted, atol=1e-2)
    seconds = read.times_s(f"/{paths.VOLTAGES}", "Scalars:scalars")
    np.testing.assert_allclose(seconds, np.arange(len(wanted)), atol=1e-9)
    assert read.values(f"/{paths.CURRENTS}", "Scalars:scalars") == []


def test_a_simulation_has_no_tracks_of_servos(trial: Trial, tmp_path: Path) -> None:
    read = ReadBack(write(tmp_path / "plain.rrd", trial))
    assert read.values(f"/{paths.TEMPERATURES}", "Scalars:scalars") == []
