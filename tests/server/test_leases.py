"""Leases: one controller at a time, for as long as it renews them."""

import pytest

from hexctl.server.leases import LEASE_S, LeaseManager, LeaseRefusedError


def test_the_first_who_asks_holds_the_robot_and_the_second_is_told_who() -> None:
    desk = LeaseManager()
    lease = desk.acquire("alice", 10.0)
    assert desk.holder(10.5) == lease
    with pytest.raises(LeaseRefusedError, match="held by alice for 1 s"):
        desk.acquire("bob", 10.9)
    assert desk.refused == 1


def test_a_lease_ends_unless_it_is_renewed() -> None:
    desk = LeaseManager()
    lease = desk.acquire("alice", 0.0)
    for third in range(1, 10):
        desk.renew(lease.lease_id, third * LEASE_S / 3)
    assert desk.holder(3.9 * LEASE_S) is not None
    assert desk.holder(4.1 * LEASE_S) is None
    with pytest.raises(LeaseRefusedError, match="no client holds"):
        desk.renew(lease.lease_id, 4.1 * LEASE_S)


def test_later_leases_have_higher_numbers_and_other_ids() -> None:
    desk = LeaseManager()
    first = desk.acquire("alice", 0.0)
    desk.release(first.lease_id, 0.1)
    second = desk.acquire("bob", 0.2)
    assert second.sequence == first.sequence + 1
    assert second.lease_id != first.lease_id
    for stale in (desk.renew, desk.release):
        with pytest.raises(LeaseRefusedError, match="bob holds"):
            stale(first.lease_id, 0.3)
    assert desk.holder(0.3) == second


def test_a_lease_can_be_taken_away() -> None:
    desk = LeaseManager()
    lease = desk.acquire("alice", 0.0)
    desk.revoke()
    assert desk.holder(0.1) is None
    with pytest.raises(LeaseRefusedError):
        desk.renew(lease.lease_id, 0.1)
    assert desk.refused == 0, "nobody else has asked"
    desk.acquire("bob", 0.1)
    with pytest.raises(LeaseRefusedError):
        desk.renew(lease.lease_id, 0.1)
    assert desk.refused == 1


def test_a_lease_cannot_be_guessed() -> None:
    desk = LeaseManager()
    desk.acquire("alice", 0.0)
    for guess in (b"", bytes(16), b"x" * 100):
        with pytest.raises(LeaseRefusedError):
            desk.release(guess, 0.1)
    assert desk.holder(0.1) is not None


def test_a_name_without_end_is_cut() -> None:
    assert len(LeaseManager().acquire("a" * 10_000, 0.0).owner) == 80


def test_commands_keep_a_lease_whose_renewals_are_lost_and_revive_none_that_has_ended() -> None:
    leases = LeaseManager(duration_s=1.0)
    lease = leases.acquire("one", 0.0)
    leases.heard(0.9)
    assert leases.holder(1.8) is not None
    assert leases.holder(1.8).lease_id == lease.lease_id  # type: ignore[union-attr]
    leases.heard(2.0)
    assert leases.holder(2.0) is None
    long = leases.acquire("two", 3.0, duration_s=10.0)
    leases.heard(4.0)
    assert leases.holder(12.0) == long
