"""One controller at a time, and which of its commands a robot accepts."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.server.leases import (
    LEASE_S,
    Checked,
    CommandCounters,
    CommandHandler,
    Lease,
    LeaseManager,
    LeaseRefusedError,
)
from hexctl.wire.ros_cdr import stamp_s
from hexctl.wire.transit_delay import BOARD_DRIFT, DRIFT, StampCheck, TransitDelay
from hexctl.wire.zenoh_messages import CommandTag, encode_positions


def test_the_first_who_asks_holds_the_robot_and_the_second_is_told_who() -> None:
    desk = LeaseManager()
    lease = desk.acquire("alice", 10.0)
    assert desk.current(10.5) == lease
    with pytest.raises(LeaseRefusedError, match="alice"):
        desk.acquire("bob", 10.9)
    assert desk.refused == 1
    assert len(LeaseManager().acquire("a" * 10_000, 0.0).owner) == 80


def test_a_lease_ends_unless_it_is_renewed() -> None:
    desk = LeaseManager()
    lease = desk.acquire("alice", 0.0)
    for third in range(1, 10):
        desk.renew(lease.lease_id, third * LEASE_S / 3)
    assert desk.current(3.9 * LEASE_S) is not None
    assert desk.current(4.1 * LEASE_S) is None
    with pytest.raises(LeaseRefusedError):
        desk.renew(lease.lease_id, 4.1 * LEASE_S)


def test_later_leases_have_higher_numbers_and_other_ids_and_earlier_ones_are_worth_nothing() -> None:
    desk = LeaseManager()
    first = desk.acquire("alice", 0.0)
    desk.release(first.lease_id, 0.1)
    second = desk.acquire("bob", 0.2)
    assert second.sequence == first.sequence + 1
    assert second.lease_id != first.lease_id
    for stale in (desk.renew, desk.release):
        with pytest.raises(LeaseRefusedError, match="bob"):
            stale(first.lease_id, 0.3)
    assert desk.current(0.3) == second
    desk.revoke()
    assert desk.current(0.4) is None
    refused = desk.refused
    with pytest.raises(LeaseRefusedError):
        desk.renew(second.lease_id, 0.4)
    assert desk.refused == refused, "no other client has asked"


def test_a_lease_cannot_be_guessed() -> None:
    desk = LeaseManager()
    desk.acquire("alice", 0.0)
    for guess in (b"", bytes(16), b"x" * 100):
        with pytest.raises(LeaseRefusedError):
            desk.release(guess, 0.1)
    assert desk.current(0.1) is not None


def test_commands_keep_a_lease_whose_renewals_are_lost_and_revive_none_that_has_ended() -> None:
    leases = LeaseManager()
    lease = leases.acquire("one", 0.0)
    leases.heard(0.9)
    held = leases.current(1.8)
    assert held is not None
    assert held.lease_id == lease.lease_id
    leases.heard(2.0)
    assert leases.current(2.0) is None
    long = leases.acquire("two", 3.0, duration_s=10.0)
    leases.heard(4.0)
    assert leases.current(12.0) == long


offsets = st.floats(-1e6, 1e6)


@given(offsets, st.lists(st.floats(0, 0.01), min_size=1, max_size=50), st.floats(0.05, 10))
def test_a_message_is_late_by_what_it_waited_longer_than_ever(
    offset_s: float, delays_s: list[float], wait_s: float
) -> None:
    transit = TransitDelay()
    for index, delay_s in enumerate(delays_s):
        late_s = transit.delay_s(index * 0.02 + offset_s, index * 0.02 + delay_s)
        assert -1e-6 <= late_s <= max(delays_s) + 1e-6
    sent_s = len(delays_s) * 0.02
    late_s = transit.delay_s(sent_s + offset_s, sent_s + min(delays_s) + wait_s)
    assert abs(late_s - wait_s) < 0.01 * wait_s + 1e-3


@pytest.mark.parametrize(("drift", "slow"), [(DRIFT, 700e-6), (BOARD_DRIFT, 0.005)])
def test_clocks_that_drift_apart_do_not_make_messages_late(drift: float, slow: float) -> None:
    transit = TransitDelay(drift=drift)
    late_s = [transit.delay_s(index * 0.02, index * 0.02 * (1 + slow)) for index in range(50_000)]
    assert max(late_s) < 1e-3


def test_a_sender_that_was_started_again_has_another_clock() -> None:
    transit = TransitDelay(other_clock_s=1.0)
    transit.delay_s(5000.0, 70.0)
    assert transit.delay_s(3.0, 75.0) == 0.0
    assert transit.delay_s(3.02, 75.03) == pytest.approx(0.01, abs=1e-3)


def test_a_late_stamp_is_late_by_the_clock_of_its_sender_until_that_is_renewed() -> None:
    check = StampCheck(5.0)
    assert all(check.admits(1000.0 + at_s, at_s) for at_s in np.arange(0.0, 3.0, 0.1).tolist())
    assert check.admits(None, 3.0)
    assert check.admits(1002.6, 3.0)
    for late_s in (0.6, 10.0, 3600.0):
        assert not check.admits(1003.0 - late_s, 3.0)
        assert check.admits(1003.0 - late_s, 3.0, sender=str(late_s).encode())
    assert check.late == 3
    assert not check.admits(7.5, 7.9)
    held_back = [
        check.admits(stamp_s, 13.0 + 0.01 * stamp_s) for stamp_s in np.arange(8.0, 13.0, 0.1).tolist()
    ]
    assert not any(held_back), "nothing came for five seconds"
    assert check.admits(13.6, 13.6)
    assert not check.admits(13.0, 13.7)


@pytest.mark.parametrize("ahead_s", [1.0, 3600.0])
def test_a_stamp_from_the_future_or_a_clock_set_back_makes_late_for_some_time_only(ahead_s: float) -> None:
    check, steady = StampCheck(), StampCheck(renewed_s=10.0)
    for one in (check, steady):
        one.admits(ahead_s, 0.0)
    admitted = [steady.admits(at_s, at_s) for at_s in np.arange(0.1, 12.0, 0.1).tolist()]
    assert admitted.index(True) == pytest.approx(100, abs=2)
    assert all(admitted[102:])
    assert not any(check.admits(at_s, at_s) for at_s in np.arange(0.1, 12.0, 0.1).tolist())
    admitted = [check.admits(at_s, at_s) for at_s in np.arange(15.0, 17.0, 0.1).tolist()]
    assert not any(admitted[:5])
    assert all(admitted[6:])


def test_stamps_are_read_in_either_byte_order_and_zero_is_none() -> None:
    assert stamp_s(encode_positions(np.zeros(18), 1_500_000_000)) == 1.5
    assert stamp_s(b"\0\0\0\0" + struct.pack(">iI", 1, 500_000_000)) == 1.5
    assert stamp_s(encode_positions(np.zeros(18), 0)) is None
    assert stamp_s(b"\0\1\0\0\1") is None


PAYLOAD = encode_positions(np.zeros(18))


def tag_for(lease: Lease, sequence: int, stamp_s: float = 0.0) -> CommandTag:
    return CommandTag(
        sequence=sequence,
        stamp_ns=round(stamp_s * 1e9),
        time_to_live_ms=200,
        lease_id=lease.lease_id,
        lease_sequence=lease.sequence,
    )


def accepted(desk: CommandHandler, lease: Lease, tag: CommandTag, at_s: float) -> Checked:
    checked = desk.check(PAYLOAD, tag.packed(), lease, at_s)
    assert checked is not None
    return checked


@pytest.fixture
def lease() -> Lease:
    return LeaseManager().acquire("alice", 0.0)


@pytest.fixture
def desk() -> CommandHandler:
    return CommandHandler()


def test_commands_in_order_and_on_time_are_obeyed(desk: CommandHandler, lease: Lease) -> None:
    for sequence in range(1, 20):
        at_s = sequence * 0.02
        checked = accepted(desk, lease, tag_for(lease, sequence, at_s), at_s)
        assert checked.sequence == sequence
        assert checked.good_for_s == pytest.approx(0.2, abs=1e-3)
    assert desk.counters == CommandCounters()


def test_repeated_and_overtaken_commands_are_dropped_and_counted(desk: CommandHandler, lease: Lease) -> None:
    for sequence in (1, 3):
        desk.check(PAYLOAD, tag_for(lease, sequence).packed(), lease, 0.0)
    assert desk.counters.lost == 1
    for sequence in (3, 2, 1, 0):
        assert desk.check(PAYLOAD, tag_for(lease, sequence).packed(), lease, 0.0) is None
    assert desk.counters.out_of_order == 4
    following = replace(lease, lease_id=bytes(range(16)), sequence=lease.sequence + 1)
    desk.check(PAYLOAD, tag_for(following, 1, -1000.0).packed(), following, 5.0)
    assert desk.newest_sequence == 1, "a new lease counts from one again"


def test_a_command_that_waited_longer_than_its_time_to_live_is_dropped(
    desk: CommandHandler, lease: Lease
) -> None:
    desk.check(PAYLOAD, tag_for(lease, 1, 0.0).packed(), lease, 100.0)
    assert desk.check(PAYLOAD, tag_for(lease, 2, 0.02).packed(), lease, 100.3) is None
    assert desk.counters.late == 1
    assert accepted(desk, lease, tag_for(lease, 3, 0.3), 100.3).delay_s < 1e-3


@pytest.mark.parametrize(("wanted_ms", "given_s"), [(60_000, 0.2), (50, 0.05)])
def test_a_time_to_live_is_at_most_that_of_the_robot(
    desk: CommandHandler, lease: Lease, wanted_ms: int, given_s: float
) -> None:
    tag = tag_for(lease, 1)._replace(time_to_live_ms=wanted_ms)
    assert accepted(desk, lease, tag, 0.0).good_for_s == pytest.approx(given_s)


def test_only_commands_under_the_lease_in_force_are_admitted_and_obeyed(
    desk: CommandHandler, lease: Lease
) -> None:
    tag = tag_for(lease, 1)
    assert desk.admits(tag.packed(), lease)
    strangers = [tag._replace(lease_id=bytes(16)), tag._replace(lease_sequence=lease.sequence + 1)]
    for other, held in ((strangers[0], lease), (strangers[1], lease), (tag, None)):
        assert not desk.admits(other.packed(), held)
        assert desk.check(PAYLOAD, other.packed(), held, 0.0) is None
    assert desk.counters == CommandCounters(stale_owner=6)


def test_what_is_no_command_is_counted(desk: CommandHandler, lease: Lease) -> None:
    good = tag_for(lease, 1).packed()
    for attachment in (None, b"", good[:-1], good + b"x"):
        assert not desk.admits(attachment, lease)
    for payload, attachment in ((b"", good), (PAYLOAD, None), (PAYLOAD, b"x"), (PAYLOAD[:50], good)):
        assert desk.check(payload, attachment, lease, 0.0) is None
    assert desk.counters == CommandCounters(malformed=8)
