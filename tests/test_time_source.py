"""Where the time comes from: this computer's, and the simulated one of the tests."""

import threading

import pytest

from hexctl.errors import RobotFaultError
from hexctl.waiting import comes_true, wait_for
from tests.backends.fake_time import FakeTime


def test_another_thread_goes_on_once_enough_simulated_time_has_passed() -> None:
    time, seen_s = FakeTime(0.0), []

    def sleeper() -> None:
        time.sleep(10.0)
        seen_s.append(time.now())

    thread = threading.Thread(target=sleeper)
    thread.start()
    time.join(thread)
    assert seen_s[0] == pytest.approx(10.0, abs=0.1)


def test_the_first_true_value_ends_the_wait_and_one_test_needs_no_time() -> None:
    values = iter([None, 0, "", "there", "later"])
    assert wait_for(lambda: next(values), 60.0, "never", poll_s=0.0) == "there"
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
