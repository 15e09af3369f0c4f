"""How late a message is, told from stamps of a clock that shares nothing with the receiver's."""

from hypothesis import given
from hypothesis import strategies as st

from hexctl.serve.transit import Transit

offsets = st.floats(-1e6, 1e6)


@given(offsets, st.lists(st.floats(0, 0.01), min_size=1, max_size=50))
def test_messages_that_take_as_long_as_ever_are_not_late(offset_s: float, delays_s: list[float]) -> None:
    transit = Transit()
    for index, delay_s in enumerate(delays_s):
        sent_s = index * 0.02
        late_s = transit.delay_s(sent_s + offset_s, sent_s + delay_s)
        assert -1e-6 <= late_s <= max(delays_s) + 1e-6


@given(offsets, st.floats(0.05, 10))
def test_a_message_that_waited_is_late_by_its_wait(offset_s: float, wait_s: float) -> None:
    transit = Transit()
    for index in range(10):
        transit.delay_s(index * 0.02 + offset_s, index * 0.02 + 0.001)
    late_s = transit.delay_s(0.2 + offset_s, 0.2 + 0.001 + wait_s)
    assert abs(late_s - wait_s) < 0.01 * wait_s + 1e-6


def test_clocks_that_drift_apart_do_not_make_messages_late() -> None:
    transit = Transit()
    late_s = [transit.delay_s(index * 0.02, index * 0.02 * (1 + 700e-6)) for index in range(100_000)]
    assert max(late_s) < 1e-3
