"""Whose command the robot follows, whatever order commands, releases, silences and stops come in."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl import InputError, Velocity
from hexctl.control.drive.arbiter import SOURCES, ZERO, Arbiter, Decision
from hexctl.errors import WrongTypeError


class Time:
    """A clock that the test sets, in whole milliseconds so that sums are exact."""

    def __init__(self) -> None:
        self.ms = 0

    def __call__(self) -> float:
        return self.ms / 1000


FORWARD = Velocity(forward_m_s=0.1)


#: What happens: a source commands or lets go, or time passes, or the stop is pressed or cleared.
EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("command"), st.sampled_from(SOURCES), st.integers(1, 9)),
        st.tuples(st.just("release"), st.sampled_from(SOURCES), st.just(0)),
        st.tuples(st.just("wait"), st.just(""), st.integers(1, 700)),
        st.tuples(st.sampled_from(["stop", "clear"]), st.just(""), st.just(0)),
    ),
    max_size=30,
)


@given(EVENTS)
def test_the_highest_source_that_spoke_lately_is_followed_and_a_stop_outweighs_all(
    events: list[tuple[str, str, int]],
) -> None:
    time = Time()
    arbiter = Arbiter(time)
    said: dict[str, tuple[int, Velocity]] = {}
    stopped = False
    for kind, name, value in events:
        if kind == "command":
            said[name] = time.ms, Velocity(forward_m_s=float(value))
            arbiter.source(name).command(said[name][1])
        elif kind == "release":
            if name in said:
                said[name] = time.ms, ZERO
            arbiter.source(name).release()
        elif kind == "wait":
            time.ms += value
        elif kind == "stop":
            arbiter.stop()
            stopped = True
        else:
            arbiter.clear()
            said, stopped = {}, False
        fresh = [one for one in SOURCES if one in said and (one == "motion" or time.ms - said[one][0] <= 500)]
        decision = arbiter.decide()
        if stopped:
            assert decision == Decision(stopped="stop")
        elif fresh:
            assert decision == Decision(said[fresh[-1]][1], fresh[-1])
        else:
            assert decision == Decision()


def test_silence_ends_a_command_also_when_the_clock_goes_back_and_the_motion_of_a_program_stays() -> None:
    time = Time()
    time.ms = 1000
    arbiter = Arbiter(time)
    arbiter.source("page").command(FORWARD)
    for ms, decision in ((900, Decision()), (1500, Decision(FORWARD, "page")), (1501, Decision())):
        time.ms = ms
        assert arbiter.decide() == decision
    arbiter.source("motion").command(FORWARD)
    time.ms = 10_000_000
    assert arbiter.decide() == Decision(FORWARD, "motion")


def test_what_was_asked_for_before_a_stop_is_cleared_does_not_move_the_robot() -> None:
    arbiter = Arbiter(Time())
    arbiter.source("motion").command(FORWARD)
    arbiter.stop("leg 3 limp")
    arbiter.stop("later")
    assert arbiter.stopped == "leg 3 limp"
    arbiter.clear()
    assert arbiter.decide() == Decision()


def test_what_is_not_allowed_is_named() -> None:
    for value in (math.nan, math.inf, -math.inf):
        with pytest.raises(InputError, match="turn_rad_s"):
            Velocity(turn_rad_s=value)
    with pytest.raises(InputError, match="source"):
        Arbiter().source("mouse")
    with pytest.raises(InputError, match="expiry_s"):
        Arbiter(expiry_s=0.6)
    with pytest.raises(WrongTypeError, match="velocity"):
        Arbiter().source("page").command(1)  # type: ignore[arg-type]
