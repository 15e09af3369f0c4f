"""Write the golden data anew: `python -m tests.golden.make`. Only for a change that is meant to be seen."""

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.cli.main import app
from hexctl.types import FloatArray
from tests.golden import choices, stored, trials
from tests.server.processes import served

DATA = stored.STORE.parent

#: The commands whose `--json` is kept, by name; those of a session and of a served robot beside them.
PRINTED = {
    "run": "run --failed-leg 5 --duration 1 --seed 0 --hold none --record walk.rrd",
    "run mock": "run --backend mock --duration 1 --no-record",
    "check": "check pexod",
    "prior show": "prior show configs/priors/ant-locked-rear-30s.npz",
}


def hexctl(folder: Path, line: str, *, json_: bool = True) -> Any:
    """What a command prints as JSON."""
    done = subprocess.run(
        [sys.executable, "-m", "hexctl", *line.split(), *(["--json"] if json_ else [])],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return json.loads(done.stdout) if json_ else done.stdout


def make_sessions(folder: Path) -> None:
    """Walk sessions and keep them; only for sessions of another form."""
    stored.place_prior(folder)
    shutil.rmtree(stored.STORE, ignore_errors=True)
    for name, (options, trials_kept) in stored.BEGUN.items():
        prior = f"--prior {stored.PRIOR}" if "bayes" in name else ""
        whole = hexctl(folder, f"adapt {options} {prior} --no-record")
        stored.keep(folder / "runs" / whole["session"], stored.STORE / name, trials_kept)


def continue_sessions(folder: Path) -> dict[str, Any]:
    """What the kept sessions are when continued."""
    stored.unpack(folder)
    return {
        name: stored.course(hexctl(folder, f"adapt {line} --no-record"))
        for name, line in stored.CONTINUED.items()
    }


def make_shapes(folder: Path) -> dict[str, Any]:
    """The shapes of what the commands write and print."""
    (folder / "configs").symlink_to(Path("configs").resolve())
    printed = {name: stored.of_json(hexctl(folder, line)) for name, line in PRINTED.items()}
    session = hexctl(folder, "adapt --failed-leg 5 --budget 2 --optimizer random --duration 1")
    printed["adapt"] = stored.of_json(session)
    printed["sessions list"] = stored.of_json(hexctl(folder, "sessions list"))
    printed["sessions show"] = stored.of_json(hexctl(folder, f"sessions show {session['session']}"))
    hexctl(folder, f"export {session['session']} --output out.csv", json_=False)
    with served(folder, backend="sim") as robot:
        printed["status"] = stored.of_json(hexctl(folder, f"status --connect {robot.endpoint}"))
        printed["estop"] = stored.of_json(hexctl(folder, f"estop --connect {robot.endpoint}"))
    recordings = folder / "runs" / session["session"]
    return {
        "json": printed,
        "files": sorted(path.name for path in recordings.iterdir()),
        "recordings": {
            "run": stored.of_recording(folder / "walk.rrd"),
            "adapt": stored.of_recording(recordings / "overview.rrd"),
        },
        "table": (folder / "out.csv").read_text(encoding="utf-8").splitlines()[0].split(","),
        "commands": stored.of_commands(app),
    }


def write(name: str, content: Any) -> None:
    """Write a file of the data."""
    text = json.dumps(content, indent=1, sort_keys=True)
    (DATA / name).write_text(f"{text}\n", encoding="utf-8")


def write_samples(samples: dict[str, dict[str, FloatArray]]) -> None:
    """Write columns of walks, each under the names of the walk and the column."""
    columns = {
        f"{name}/{column}": values for name, walk in samples.items() for column, values in walk.items()
    }
    np.savez_compressed(DATA / "walks.npz", allow_pickle=False, **columns)


def main() -> None:
    """Write all files."""
    DATA.mkdir(exist_ok=True)
    cases = trials.trials()
    results = {name: trials.alone(trial) for name, trial in cases.items()}
    write(
        "trials.json",
        {
            "probe": trials.probe(),
            "results": {name: walked.result for name, walked in results.items()},
            "logs": {name: walked.log for name, walked in results.items()},
        },
    )
    write_samples({name: walked.samples for name, walked in results.items()})
    write(
        "choices.json",
        {
            "bayes": {case: choices.believed(*arguments) for case, arguments in choices.BELIEVED.items()},
            "bare": {f"{name} {seed}": choices.bare(name, seed) for name, seed in choices.SEARCHES},
            "asked": {f"{name} {seed}": choices.asked(name, seed) for name, seed in choices.SEARCHES},
        },
    )
    if not stored.STORE.exists():
        with tempfile.TemporaryDirectory() as folder:
            make_sessions(Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        write("sessions.json", continue_sessions(Path(folder)))
    with tempfile.TemporaryDirectory() as folder:
        write("shapes.json", make_shapes(Path(folder)))


if __name__ == "__main__":
    main()
