"""No room of the package grows: a ceiling of lines for each, which may only be lowered."""

from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "hexctl"

#: Most lines of each folder of the package, and of the modules directly in it.
CEILINGS = {
    "": 2_445,
    "adapt": 7_713,
    "backends": 11_843,
    "browser": 1_725,
    "cli": 6_852,
    "client": 1_020,
    "control": 16_043,
    "demo": 220,
    "doctor": 646,
    "export": 1_847,
    "gait": 735,
    "identify": 1_665,
    "ik": 1_190,
    "learning": 438,
    "recording": 3_859,
    "robot": 7_340,
    "runs": 1_411,
    "server": 3_980,
    "simulators": 3_801,
    "study": 6_995,
    "teleop": 2_300,
    "testing": 640,
    "vision": 4_835,
    "wire": 3_331,
}


def lines_of(room: str) -> int:
    folder = PACKAGE / room
    files = folder.rglob("*.py") if room else folder.glob("*.py")
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)


def test_every_room_has_a_ceiling() -> None:
    rooms = {folder.name for folder in PACKAGE.iterdir() if (folder / "__init__.py").is_file()}
    assert rooms <= CEILINGS.keys(), "a new room needs a ceiling"


def test_no_room_is_above_its_ceiling() -> None:
    lines = {room: lines_of(room) for room in CEILINGS}
    above = {room: count for room, count in lines.items() if count > CEILINGS[room]}
    assert not above, "remove something before you add, or merge what says the same"
