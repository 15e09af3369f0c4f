"""What is stored in a servo with registers and matters before it moves: set up, checked, renewed.

Nothing here switches a torque. Settings that are kept without power are written only where they have to
change, while the torque is off, and what is changed is said.
"""

from dataclasses import dataclass

from hexctl.backends.bus.register.registers import bit_words
from hexctl.backends.bus.register.servo import RegisterServo

#: What helps where a setting that is made without torque was not made.
_LATER = "switch its power off and on, and it is set"


#: Shares of a torque that differ by no more are the same: a count of any servo is less.
TORQUE_SHARE = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoSettings:
    """Settings of one servo.

    Attributes:
        refusal: why it cannot be walked with; empty where it can.
        notes: what is worth knowing.
        least: lowest goal that it takes, in counts; -inf where it does not say.
        most: highest goal that it takes, in counts; inf where it does not say.
    """

    refusal: str
    notes: tuple[str, ...]
    least: float
    most: float


def set_up(servo: RegisterServo) -> list[str]:
    """Set up a servo that has no torque: answers without delay, position mode; notes on what was changed.

    Where settings can be kept from being saved, they are.
    """
    table, notes = servo.table, []
    if table.unlock is not None and servo.sure(table.unlock) == 0:
        servo.write(table.unlock, 1)
    if said := servo.change(table.return_delay, 0):
        notes.append(f"its return delay cannot be set to 0 ({said})")
    mode = servo.sure(table.mode)
    if table.mode is not None and mode not in (None, table.position_mode):
        said = servo.change(table.mode, table.position_mode)
        notes.append(_changed(f"its operating mode from {mode} to {table.position_mode}", said))
    flags = servo.sure(table.flags)
    if table.flags is not None and flags is not None and (words := bit_words(table.cleared, flags)):
        said = servo.change(table.flags, flags & ~sum(1 << bit for bit in table.cleared))
        notes.append(_changed(f"its flag for {words} off", said))
    return notes


def _changed(what: str, said: str) -> str:
    return f"could not set {what} ({said})" if said else f"set {what}"


def settings_of(servo: RegisterServo) -> ServoSettings:
    """Settings of a servo, as far as it says them."""
    table = servo.table
    least, most = servo.sure_value(table.least), servo.sure_value(table.most)
    mode, flags = servo.sure(table.mode), servo.sure(table.flags)
    refusal = ""
    if table.mode is not None and mode not in (None, table.position_mode):
        refusal = f"its operating mode is {mode}, not {table.position_mode} (position); {_LATER}"
    elif table.mode is None and least == most == 0:
        refusal = "it is in wheel mode, with both angle limits at 0; set them with the vendor's tool"
    elif flags is not None and (words := bit_words(table.cleared, flags)):
        refusal = f"its flag for {words} is on; {_LATER}"
    elif flags is not None and (words := bit_words(table.refused, flags)):
        address = 0 if table.flags is None else table.flags.address
        refusal = f"{words} (register {address} is {flags}); clear that with the vendor's tool"
    unlimited = least is None or most is None or not least < most
    return ServoSettings(
        refusal=refusal,
        notes=tuple(_notes(servo)),
        least=float("-inf") if unlimited or least is None else least,
        most=float("inf") if unlimited or most is None else most,
    )


def _notes(servo: RegisterServo) -> list[str]:
    table, notes = servo.table, []
    shutdown = servo.sure(table.shutdown)
    if shutdown is not None and (missing := bit_words(table.protections, ~shutdown)):
        notes.append(f"it does not protect itself from {missing}")
    notes += _overload_notes(servo)
    greatest, now = servo.sure_value(table.max_torque), servo.sure_value(table.soft_torque)
    if greatest == 0:
        notes.append("its greatest torque is set to 0")
    elif greatest is not None and now is not None and 0 < now < greatest - TORQUE_SHARE:
        notes.append(f"its torque is limited to {100 * now:.0f} % until it restarts")
    if speed := servo.sure_value(table.speed):
        notes.append(f"its speed is limited to {speed:.0f} degrees/s")
    if alert := hardware_error(servo):
        notes.append(f"it has let go ({alert}); switch its power off and on")
    return notes


def _overload_notes(servo: RegisterServo) -> list[str]:
    """What is said of a servo that protects itself less from an overload than from the factory."""
    overload = servo.table.overload
    if overload is None:
        return []
    registers = (overload.load, overload.time_s, overload.torque)
    values = [servo.sure_value(register) for register in registers]
    known = [(own, usual) for own, usual in zip(values, overload.factory, strict=True) if own is not None]
    if len(known) < len(registers) or all(own <= usual + TORQUE_SHARE for own, usual in known):
        return []

    def words(load: float, time_s: float, torque: float) -> str:
        return f"{100 * torque:.0f} % of its torque after {time_s:g} s above {100 * load:.0f} %"

    own, usual = words(*(own for own, _ in known)), words(*overload.factory)
    return [f"after an overload it gives {own}, from the factory {usual}"]


def hardware_error(servo: RegisterServo) -> str:
    """Why a servo has let go, in words; empty for none and where it does not say."""
    bits = servo.sure(servo.table.hardware_error)
    return "" if bits is None else bit_words(servo.table.hardware_errors, bits)


def renew_torque_limit(servo: RegisterServo) -> None:
    """Give a servo whose torque limit is 0, as AX servos have it after an overload, its greatest torque."""
    table = servo.table
    if table.torque_limit is None or table.max_torque is None or servo.sure(table.torque_limit) != 0:
        return
    greatest = servo.sure_value(table.max_torque)
    if greatest:
        servo.change(table.torque_limit, greatest)
