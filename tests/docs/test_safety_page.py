"""The pages on safety and security agree with the code: times, and who may do what."""

import math
import re
from typing import Any

import pytest

from faults.measurement import REST_S
from faults.results import RESULTS, Results
from faults.table import rests_s
from hexctl.backends.clock import PERIOD_S
from hexctl.control.drive.arbiter import COMMAND_EXPIRY_S
from hexctl.control.guard import EXPIRY_S, FALL_COS_TILT, FALL_TICKS, POSE_EXPIRY_S
from hexctl.control.telemetry_watch import BATTERY_S, LASTS_S
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.server.idle import SIT_AFTER_S, STILL_S
from hexctl.server.leases import LEASE_S
from hexctl.simulators.servo_board import FREE_AFTER_S, RELEASE_AFTER_S, RESUME_AFTER_S
from hexctl.types import TOO_HOT_C
from hexctl.wire.certificates import CertificateOptions
from hexctl.wire.links import KeyMap, Role
from hexctl.wire.stop import LOCKOUT_S, MOST_OTHERS_LOCKOUT_S, OTHERS_LOCKOUT_S
from hexctl.wire.stop_datagram import STOP_ROLES
from hexctl.wire.zenoh_session import access_control
from tests.docs.pages import ROOT

SAFETY = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
SECURITY = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
FIRMWARE = (ROOT / "docs" / "reference" / "mavlink.md").read_text(encoding="utf-8")

#: Which test holds which promise of both pages.
PROMISES = (ROOT / "docs" / "dev" / "safety-promises.md").read_text(encoding="utf-8")

#: Texts of pages with constants of the code.
TIMES = {
    "age": (SAFETY, f"older than {EXPIRY_S:g} s"),
    "silence": (SAFETY, f"`expired`: controller silent | freezes; sits down after {SIT_AFTER_S:g} s"),
    "state": (SAFETY, f"no state for {EXPIRY_S:g} s"),
    "fall": (
        SAFETY,
        f"leans by more than {math.degrees(math.acos(FALL_COS_TILT)):.0f}° for {FALL_TICKS * PERIOD_S:g} s",
    ),
    "pose": (SAFETY, f"a known pose stays away for {POSE_EXPIRY_S:g} s"),
    "heat": (SAFETY, f"a servo at {TOO_HOT_C:g} °C or more"),
    "jump": (SAFETY, f"a jump after {LASTS_S:g} s"),
    "battery": (SAFETY, f"below `low_battery_v` for {BATTERY_S:g} s"),
    "sitting": (SAFETY, f"sits down after {SIT_AFTER_S:g} s (`--sit-after`)"),
    "lease": (SAFETY, f"lease not renewed for {LEASE_S:g} s"),
    "driver": (SAFETY, f"driver silent, after {COMMAND_EXPIRY_S:g} s"),
    "soft stop": (SAFETY, f"{RAMP_DURATION_S:g} s; 2.04 s (n 14)"),
    "rest": (SAFETY, f"its joints first stayed still for {STILL_S:g} s"),
    "board": (SAFETY, f"holds after {EXPIRY_S:g} s, goes limp after {RELEASE_AFTER_S:g} s"),
    "clear": (SECURITY, f"with the id of the stop, {LOCKOUT_S:g} s after it at the earliest"),
    "others": (SECURITY, f"another user's stop after {OTHERS_LOCKOUT_S:g} s"),
    "repeated": (SECURITY, f"holds up to {MOST_OTHERS_LOCKOUT_S:g} s"),
    "cut": (SECURITY, f"stops after {EXPIRY_S:g} s"),
    "peer": (SECURITY, f"the commander was silent for {FREE_AFTER_S:g} s"),
    "days": (SECURITY, f"({CertificateOptions().days} days unless given)"),
    "release": (FIRMWARE, f"for {RELEASE_AFTER_S:g} s"),
    "resume": (FIRMWARE, f"overrides that have come for {RESUME_AFTER_S:g} s"),
    "commander": (FIRMWARE, f"silent for {FREE_AFTER_S:g} s"),
}


@pytest.mark.parametrize("name", TIMES)
def test_the_pages_have_the_times_of_the_code(name: str) -> None:
    page, text = TIMES[name]
    assert text in page


#: Faults of the matrix whose maximum times to rest the table of stops has, by its words.
SILENCES = {
    "killed": ("controller-killed",),
    "cable out": ("cable-out",),
    "frozen": ("frozen-0.3", "frozen-5"),
    "messages 0.3 s late": ("delay-0.3",),
}


def test_the_table_of_stops_has_the_maximum_times_of_the_matrix() -> None:
    injected = [one for one in Results(ROOT / RESULTS).read() if one.punctual]
    of_silence = {
        words: [one for one in injected if one.fault in faults] for words, faults in SILENCES.items()
    }
    times = ", ".join(f"{words} {rests_s(of).max():.2f} s" for words, of in of_silence.items())
    numbers = [
        sum(one.fault == fault for one in injected) for faults in SILENCES.values() for fault in faults
    ]
    text = f"maximum: {times} ({min(numbers)} to {max(numbers)} injections each"
    assert text in SAFETY
    falls = rests_s([one for one in injected if one.fault == "fallen"])
    assert f"at rest within {REST_S} s of the push in {(falls <= REST_S).sum()} of {falls.size}" in SAFETY


def allowed(role: Role) -> set[tuple[str, str]]:
    """Messages and keys that a robot with certificates takes from a role."""
    control: dict[str, Any] = access_control(KeyMap.of("ant"), certified=True)
    named = {
        name for policy in control["policies"] if role.value in policy["subjects"] for name in policy["rules"]
    }
    rules = [rule for rule in control["rules"] if rule["id"] in named and "ingress" in rule["flows"]]
    return {
        (message, key.rpartition("/")[2])
        for rule in rules
        for message in rule["messages"]
        for key in rule["key_exprs"]
    }


def test_a_viewer_reads_and_nothing_else() -> None:
    taken = allowed(Role.VIEWER)
    assert {message for message, _ in taken} == {"declare_subscriber", "query"}
    assert {key for message, key in taken if message == "query"} == {"describe"}
    assert Role.VIEWER not in STOP_ROLES  # of the secret of the datagram stop


def test_a_controller_commands_stops_and_sets_the_pose() -> None:
    taken = allowed(Role.CONTROLLER)
    assert {key for message, key in taken if message == "put"} == {"command", "pose"}
    assert {key for message, key in taken if message == "query"} == {"describe", "lease", "estop", "failure"}


def test_there_is_no_role_above_the_controller() -> None:
    assert {role.value for role in Role} == {"robot", "controller", "viewer"}


def test_each_test_that_holds_a_promise_is_there() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", PROMISES)
    assert len(named) > 30
    missing = [
        f"{file}::{name}"
        for file, name in named
        if not re.search(rf"^def {name}\(", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert not missing
