"""Which of many datagrams are checked: no sender keeps out another, and nothing is checked twice."""

from hexctl.server.stops.stop_socket import MOST_NONCES, AnsweredNonces, Waiting, sort_datagrams
from hexctl.wire.stop_datagram import Kind, StopDatagram, mark_of

OPERATOR, STRANGER = ("10.0.0.1", 1), ("10.0.0.2", 2)


def test_a_sender_of_a_thousand_does_not_keep_out_another() -> None:
    waiting = Waiting()
    waiting.add(b"mine", OPERATOR)
    for number in range(1000):
        waiting.add(number.to_bytes(2), STRANGER)
    first = list(waiting)[:2]
    assert sorted(first) == [((999).to_bytes(2), STRANGER), (b"mine", OPERATOR)]
    assert len(list(waiting)) == 1001


def test_a_copy_of_a_datagram_waits_once_for_its_first_sender() -> None:
    waiting = Waiting()
    waiting.add(b"mine", OPERATOR)
    waiting.add(b"mine", STRANGER)
    assert list(waiting) == [(b"mine", OPERATOR)]


def test_datagrams_are_sorted_by_their_bytes() -> None:
    kinds = {kind: StopDatagram(kind=kind, nonce=bytes([kind]) * 8).packed(b"") for kind in Kind}
    old = StopDatagram(kind=Kind.ASK, nonce=b"answered").packed(b"")
    answered = AnsweredNonces()
    answered.add(b"answered")
    came = [(data, OPERATOR) for data in (*kinds.values(), old, b"short", b"", bytes(160))]
    stops, questions, foreign = sort_datagrams(came, mark_of(b""), answered)
    assert list(stops) == [(kinds[Kind.STOP], OPERATOR)]
    assert list(questions) == [(kinds[Kind.ASK], OPERATOR)]
    assert foreign == 4


def test_many_answered_nonces_take_bounded_space() -> None:
    answered = AnsweredNonces()
    for number in range(3 * MOST_NONCES):
        answered.add(number.to_bytes(8))
    known = [number.to_bytes(8) in answered for number in range(3 * MOST_NONCES)]
    assert all(known[-MOST_NONCES:])
    assert sum(known) <= 2 * MOST_NONCES
