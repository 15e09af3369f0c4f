"""Command lines that are refused: exit code 2, one line that names the option, and nothing is written."""

import shlex
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from hexctl.robot.configs import config_root
from tests.cli.conftest import Call

#: Command lines, and what the message names.
REFUSED = """
run --robot /nowhere/bob.yaml => /nowhere/bob.yaml
run --world full => 'full' is a folder
run --world transfer:-1 => --world
run --gait 121 --failed-leg 2 => --gait
run --then lope@0.3 => --then
run --duration 1 --then wave@5 => --then
run --amplitude 0.6 => leg 1
run --height -1 => height
run --tuck 1,2,3,4 => --tuck
run --trim 2 => --trim
run --stance-shift 1 => --stance-shift
run --arena wide => --arena
run --failed-leg 5 --failed-leg 6 => --failed-leg: typed 2 times; allowed: once, several values with commas
run --failed-leg 5 --failure 5:locked@8 => --failure: got 5:locked@8, when leg 5 is locked already
run --gait best:nosuch => nosuch
prior build --failed-leg 5 => --failed-leg; did you mean --legs?
run --failed-leg auto,5 => --failed-leg
run --failed-leg auto --failure limp => --failure
run --failed-leg auto --backend mock --failure 5:limp => --failure
run --failure 5:stuck:femur:10@3 => --failure
run --failure 5:locked@31 => --failure
run --failure 5:locked@3 --backend mock => --failure
run --heal 5@5 => --heal
run --heal 5@8 --backend zenoh => --heal
run --policy stop --recover => --recover
run --backend json:JSONDecoder => json:JSONDecoder
run --backend no.such:Thing => no.such:Thing
run --connect tcp/127.0.0.1:1 => --connect
adapt --failed-leg 5 --worth 0.1 --optimizer pso => --worth
adapt --failed-leg 5 --objective haste => --objective
adapt --failed-leg 5 --objective speed --target 1% => --target
adapt --failed-leg 5 --ask => --ask
adapt --failed-leg 5 --backend mock --arena 1 => --arena
adapt --failed-leg 5 --backend mock --arena 5 --heading 20 => --heading
adapt --failed-leg 5 --backend mock --connect tcp/robot:7447 => --connect
adapt --failed-leg 5 --prior x.npz --optimizer pso => --prior
adapt --failed-leg 5 --prior none --optimizer bayes => --prior
adapt --failed-leg 5 --early-stop --optimizer random => --early-stop
adapt --failed-leg 5 --early-stop --duration 2.5 => --prior
adapt --failed-leg 5 --objective mean --optimizer bayes => objective
adapt --failed-leg 5 --count-repeats --optimizer bayes => --count-repeats
adapt --failed-leg 5 --world randomised => randomised
adapt --resume some --seed 30 => --seed
adapt --resume some --keys here --ask => --ask
drive => --keyboard
drive --page-keys keys => --page-keys
drive --page 0.0.0.0:0 => --page
drive --page 127.0.0.1:0 --page-keys no => --page-keys
drive --page-view http://camera/ => --page-view
drive --page 127.0.0.1:0 --page-view camera => --page-view
drive --page 127.0.0.1:0 --record full/thesis.rrd => full/thesis.rrd
drive --gamepad a-file => a-file
drive --no-record --record x.rrd => --no-record
diagnose --backend mock --failed-leg 2 => --failed-leg
diagnose --failure 2:limp@3 => --failure
check ant --robot pexod => pexod
view --keys x => --keys
view a.rrd --connect tcp/127.0.0.1:1 => --connect
sessions show nobody => nobody
export nosuch --to csv => session
export ant -o a-file/ant.urdf => a-file is a file
serve --backend zenoh => --backend
serve --backend mock --failed-leg 5 => --failed-leg
serve --failure 5:limp@8 => --failure
serve --connect /dev/null => --connect
serve --backend mavlink --seed 5 => --seed
serve --ros-drive => --ros-drive
serve --ros --ros-namespace 'a b' => --ros-namespace
serve --ros tls/localhost:7447 => --ros
serve --ros --listen tcp/127.0.0.1:7447 => --listen
status --watch --json => --watch
calibrate ant => ant
calibrate mine.yaml --joints leg7 => --joints
servos scan --robot freenove-big => hobby servos
servos scan --driver feetech --connect x --baud 9 => --baud
servos identify --model lx224 --driver feetech --connect x => --model
servos set-id 300 --driver feetech --connect x => 300
servos adopt --robot phantomx --connect x => --driver
servos adopt --connect x => --robot
see --camera no-such.mp4 --no-link => --camera
see --camera 0 --page 0.0.0.0:8019 => --page
see latency => --camera
see calibrate a.png --camera 0 => --camera
see calibrate nowhere.png --output none/lens.yaml => --output
sim camera --size 8x8 => --size
sim camera --position 1,2 => --position
sim camera --position 0,0,-1 => --position
sim camera --fault fogged@3 => --fault
sim board --connect COM3 => --connect
sim board --connect udpin:127.0.0.1:1 --pty => --pty
sim board --connect udpin:192.168.1.2:14550 => network
sim board --keys no-such-folder => no-such-folder/mavlink.key
sim board --bus hitec => hitec
sim board --bus feetech --connect udpin:127.0.0.1:1 => --connect
sim board --bus feetech --fault noise => --fault
sim board --bus feetech --model ax12a => ax12a
sim board --bus pca9685 --fault mute => mute
study --optimizers annealing => annealing
study --failure weak:2 => --failure
study --prior auto => --prior
study --out a-file => --out
study --out full => holds other things
study --time-steps 2 => --time-steps
study --holds line => --holds
study --matrix --time-steps 3 => --time-steps
study --matrix --transfer => --matrix
study --transfer --self-rotation front => --self-rotation
study --transfer --failure limp => prior
study --transfer --world slippery => --world
study --hold --optimizers pso => --optimizers
study --hold --holds auto => --holds
study --hold --robot ant,ant => --robot
study --recovery --hold => --recovery
study --recovery --budget 3 => --budget
study --recovery --methods nothing,hope => --methods
study --recovery --protocols ours => --protocols
study --recovery --duration 9 => --duration
identify --p-gain 16 --robot lukas => --p-gain
identify walk.rrd --p-gain 16 => --p-gain
identify walk.rrd --record new.rrd => --record
identify walk.rrd --yes => --yes
identify -o none/identified.yaml => --output
identify -o a-file/identified.yaml => --output
identify --backend mock --world stand => --world
prior build --legs '' => --legs
prior build --family flat => ranges
prior build --out x.zip => --out
prior build --out folder.npz => --out
prior build --dask nonsense => --dask
prior build --directions 4 => --directions
prior build --repertoire --failure limp => --failure
prior build --repertoire --directions 5 => --directions
prior build --repertoire --family failing => --family
prior show diary.npz => diary.npz
prior show --repertoire diary.npz => diary.npz
prior show nowhere.npz => FILE: no file at
"""

#: A command line and its message, by turns.
MESSAGES = Path(__file__).with_name("messages.txt")

CASES = [line.rpartition(" => ")[::2] for line in REFUSED.strip().splitlines()]


@pytest.fixture(autouse=True)
def _with_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.cli.prompts.can_answer", lambda: True)
    for name in ("a-file", "full/thesis.rrd", "folder.npz/x", "diary.npz"):
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text("mine")
    Path("mine.yaml").write_text((config_root() / "robots" / "ant.yaml").read_text())


def files() -> dict[Path, int]:
    return {path: path.stat().st_size for path in Path().rglob("*") if path.is_file()}


@pytest.mark.parametrize(("line", "named"), CASES, ids=[line for line, _ in CASES])
def test_it_is_refused_in_one_line_that_names_the_option(line: str, named: str, call: Call) -> None:
    before = files()
    assert named in call(*shlex.split(line), code=2).refusal
    assert files() == before


def test_messages_that_users_often_see(capsys: pytest.CaptureFixture[str]) -> None:
    told = []
    for line in MESSAGES.read_text().splitlines()[::2]:
        exit_code(shlex.split(line.removeprefix("$ hexctl ")))
        told += [line, capsys.readouterr().err.rstrip("\n")]
    assert told == MESSAGES.read_text().splitlines()
