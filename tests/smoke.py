"""Run with a robot's own computer's Python: serves, walks, asks, stops, with nothing but hexctl installed.

Then the simulation is installed by the command that its error names. `python smoke.py HEXCTL`; standard
library only, because nothing of the checkout is there.
"""

import importlib.resources
import importlib.util
import json
import socket
import subprocess
import sys


def main(hexctl: str) -> None:
    """Serve a mock robot and walk it over the link; fail where MuJoCo or Rerun are installed after all."""
    for extra in ("mujoco", "dm_control", "rerun", "matplotlib"):
        if importlib.util.find_spec(extra) is not None:
            sys.exit(f"{extra} is installed here, so this shows nothing")
    template = importlib.resources.files("hexctl") / "study" / "templates" / "report.html"
    assert template.is_file(), f"{template} is not in the wheel"
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    served = subprocess.Popen(
        [hexctl, "serve", "--backend", "mock", "--robot", "pexod", "--listen", endpoint],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert served.stderr is not None
        greeting = served.stderr.readline()
        assert "serving pexod" in greeting, greeting
        walk = ("run", "--backend", "zenoh", "--robot", "pexod", "--no-record", "--duration", "1", "--json")
        walked = json.loads(call(hexctl, *walk, "--connect", endpoint))
        assert walked["status"] == "ok", walked
        status = json.loads(call(hexctl, "status", "--json", "--connect", endpoint))
        assert status["commands"]["accepted"] > 50, status
        assert "stopped (estop)" in call(hexctl, "estop", "--connect", endpoint)
    finally:
        served.terminate()
        served.wait(10)
    simulate(hexctl)


def simulate(hexctl: str) -> None:
    """Walk in simulation, after the one command that the error names."""
    walk = (hexctl, "run", "--no-record", "--duration", "2", "--json")
    refused = subprocess.run(walk, capture_output=True, text=True, check=False)
    assert refused.returncode != 0, refused.stdout
    command = refused.stderr.strip().partition("extra: ")[2]
    sys.stdout.write(f"$ {command}\n")
    # Names a shell expands, as a person would type it.
    subprocess.run(command, shell=True, check=True, stdout=subprocess.DEVNULL)  # noqa: S602
    walked = json.loads(call(*walk))
    assert walked["status"] == "ok", walked
    labmaze = importlib.util.find_spec("labmaze") is not None
    assert labmaze == (sys.version_info < (3, 13)), "labmaze has no wheels from Python 3.13 on"


def call(*command: str) -> str:
    """Return what a command prints."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


if __name__ == "__main__":
    main(sys.argv[1])
