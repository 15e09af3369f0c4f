"""Options that say where a robot is, and by which certificates it is reached."""

from pathlib import Path
from typing import Annotated, Any

import typer

KeysOption = Annotated[
    Path | None,
    typer.Option(
        "--keys",
        help="Folder of certificates that hexctl keys new made; needed beyond this computer. (default: none)",
    ),
]

InsecureOption = Annotated[
    bool,
    typer.Option(
        "--insecure",
        help="Go without certificates beyond this computer: every client there can move the robot.",
    ),
]

LinkOption = Annotated[
    str | None,
    typer.Option(
        "--link",
        help="YAML file that says where a robot is, its certificates and the names of its messages "
        "(docs/protocol.md). (default: none)",
    ),
]

ListenOption = Annotated[
    str | None,
    typer.Option(
        "--listen",
        help="Where to listen: PROTOCOL/HOST:PORT with tcp, tls or quic, such as tls/0.0.0.0:7447. "
        "(default: tcp/127.0.0.1:7447)",
    ),
]

DeviceOption = Annotated[
    str | None,
    typer.Option(
        "--device",
        help="With mavlink, the servo board's port: /dev/ttyACM0:115200, udpout:HOST:PORT or "
        "udpin:HOST:PORT (default: udpout:127.0.0.1:14550); with dynamixel, feetech and lx16a that of "
        "the bus: /dev/ttyUSB0:1000000, with servo2040 that of the board: /dev/ttyACM0, and with pca9685 "
        "the I2C bus: /dev/i2c-1. "
        "(default: that of the robot file)",
    ),
]


def board_secret(flag: str, text: str) -> Any:
    """Option with the folder of the secret by which a MAVLink board and its controller sign."""
    folder = "folder with mavlink.key, the board's secret"
    return typer.Option(flag, help=f"{text.format(folder)} (default: none)")


DeviceKeysOption = Annotated[
    Path | None, board_secret("--device-keys", "With mavlink, {}: only what it signed is believed.")
]
BoardKeysOption = Annotated[Path | None, board_secret("--keys", "The {}: only what it signed is obeyed.")]
BoardInsecureOption = Annotated[
    bool, typer.Option("--insecure", help="Let others than this computer command without that secret.")
]
