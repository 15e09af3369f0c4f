"""Models of bus servos."""

import pytest

from hexctl.errors import InputError
from hexctl.robot.servos.drivers import BUS_DRIVERS
from hexctl.robot.servos.servo_models import DEFAULT_BAUDS, DEFAULT_MODELS, SERVO_TYPES, servo_type


def test_models_are_found_by_name() -> None:
    assert servo_type("sts3215").number == 777
    assert servo_type("ax12a").counts_per_deg == pytest.approx(3.41)
    assert servo_type("xl430-w250").counts_per_deg == pytest.approx(11.378, abs=1e-3)
    assert servo_type("lx16a").counts_per_deg == pytest.approx(1000 / 240)
    with pytest.raises(InputError, match=r"servos.model: got 'x'; allowed: ax12a, "):
        servo_type("x")


def test_every_driver_has_a_model_to_begin_with() -> None:
    assert set(DEFAULT_MODELS) == set(DEFAULT_BAUDS) == set(BUS_DRIVERS)
    assert all(SERVO_TYPES[model].driver == driver for driver, model in DEFAULT_MODELS.items())
    for model in SERVO_TYPES.values():
        assert model.least <= model.centre <= model.most
