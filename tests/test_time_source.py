"""Where the time comes from: this computer's, and the simulated one of the tests."""

import threading

import pytest

from hexctl.errors import RobotFaultError
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.waiting import comes_true, wait_for
from tests.backends.fake_time import FakeTime


@pytest.fixture(params=["wall", "simulated"])
def time(request: pytest.FixtureRequest) -> TimeSource:
    return WALL_TIME if request.param == "wall" else FakeTime()


def test_a_sleep_takes_its_time(time: TimeSource) -> None:
    before_s = time.now()
    time.sleep(0.01)
    assert time.now() - before_s >= 0.01 - 1e-9


def test_an_event_that_is_set_is_not_waited_for(time: TimeSource) -> None:
    event, before_s = threading.Event(), time.now()
    event.set()
    assert time.wait(event, 600.0)
    assert time.now() - before_s < 60.0


def test_an_event_that_is_not_set_is_waited_for_until_the_timeout(time: TimeSource) -> None:
    before_s = time.now()
    assert not time.wait(threading.Event(), 0.01)
    assert time.now() - before_s >= 0.01 - 1e-9


def test_a_condition_is_waited_for_until_the_timeout(time: TimeSource) -> None:
    condition, before_s = threading.Condition(), time.now()
    with condition:
        assert not time.wait(condition, 0.01)
    assert time.now() - before_s >= 0.01 - 1e-9


def test_another_thread_goes_on_once_enough_simulated_time_has_passed() -> None:
    time, seen_s = FakeTime(0.0), []

    def sleeper() -> None:
        time.sleep(10.0)
        seen_s.append(time.now())

    thread = threading.Thread(target=sleeper)
    thread.start()
    time.join(thread)
    assert seen_s[0] == pytest.approx(10.0, abs=0.1)


def test_the_first_true_value_ends_the_wait() -> None:
    values = iter([None, 0, "", "there", "later"])
    assert wait_for(lambda: next(values), 60.0, "never", poll_s=0.0) == "there"


def test_a_condition_is_tested_once_even_without_time() -> None:
    assert wait_for(lambda: 5, 0.0, "never") == 5


@pytest.mark.parametrize("message", ["it never came", lambda: "it never came"])
def test_a_condition_that_stays_false_is_an_error_with_the_message(message: str) -> None:
    time = FakeTime(50.0)
    with pytest.raises(RobotFaultError, match="it never came"):
        wait_for(lambda: None, 60.0, message, poll_s=0.5, time=time)
    assert time.now() == pytest.approx(110.0, abs=1.0)


def test_a_condition_that_comes_true_in_time_is_not_waited_for_any_longer() -> None:
    time = FakeTime(50.0)
    assert comes_true(lambda: time.now() > 60.0, 60.0, poll_s=0.5, time=time)
    assert time.now() == pytest.approx(60.0, abs=1.0)


def test_what_a_condition_raises_ends_the_wait() -> None:
    def broken() -> None:
        raise OSError("no link")

    with pytest.raises(OSError, match="no link"):
        wait_for(broken, 60.0, "never")
