"""The newest messages of a robot, as its client puts them together."""

from types import SimpleNamespace

import numpy as np
import pytest

from hexctl.backends.zenoh.subscriber import LatestValues, StateSubscriber
from hexctl.errors import RobotFaultError
from hexctl.wire.links import KeyMap
from hexctl.wire.zenoh_messages import StateTag, encode_positions
from tests.backends.fake_time import FakeTime


def state(sequence: int) -> SimpleNamespace:
    tag = StateTag(
        sequence=sequence,
        stamp_ns=0,
        age_us=0,
        command_sequence=0,
        measured=True,
        healthy=True,
        contacts=None,
    )
    return SimpleNamespace(payload=encode_positions(np.zeros(18)), attachment=tag.packed())


def test_states_of_before_the_lease_are_not_waited_for() -> None:
    """They come on another thread than the answer that grants it, and may tell of a stop that it lifted."""
    latest = LatestValues(FakeTime())
    states = StateSubscriber(KeyMap.of("ant"), latest)
    states.forget(after=5)
    for sequence in (4, 5):
        latest.put("joint_states", state(sequence))
        with pytest.raises(RobotFaultError, match="sends no state"):
            states.wait_for_first_s()
    latest.put("joint_states", state(6))
    assert states.wait_for_first_s() == states.heard_at_s


def test_a_robot_that_numbers_no_leases_is_heard_at_once() -> None:
    latest = LatestValues()
    states = StateSubscriber(KeyMap.of("ant"), latest)
    states.forget()
    latest.put("joint_states", state(1))
    assert states.wait_for_first_s() == states.heard_at_s
