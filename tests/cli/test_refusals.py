"""Command lines that are refused: exit code 2, one line that names the option, and nothing is written."""

import shlex
from pathlib import Path

import pytest

from hexctl.robot.configs import config_root
from tests.cli.conftest import Call

#: Command lines, and what the message names.
REFUSED = """
run --robot /nowhere/bob.yaml => /nowhere/bob.yaml
run --world full => 'full' is a folder
run --world transfer:-1 => --world: got 'transfer:-1'; allowed: the number of a member
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
run --failed-leg auto,5 => --failed-leg
run --failed-leg auto --failure limp => --failure
run --failed-leg auto --backend mock --failure 5:limp => --failure
run --failure 5:stuck:femur:10@3 => --failure
run --failure 5:locked@31 => --failure
run --failure 5:locked@3 --backend mock => --failure
run --heal 5@5 => --heal
run --heal 5@8 --backend zenoh => --heal
run --recovery stop --recover => --recover
run --backend json:JSONDecoder => json:JSONDecoder
run --backend no.such:Thing => no.such:Thing
run --connect tcp/127.0.0.1:1 => --connect
run --backend feetech --connect /dev/ttyUSB0 => the port of servos is --port
run --backend zenoh --port /dev/ttyUSB0 => --port
run --robot phantom => did you mean 'phantomx'?
run --robot bob => unknown robot 'bob'; allowed: ant,
run --world slipery => did you mean 'slippery'?
run --world lava => unknown world 'lava'; allowed: flat,
run --gait 721 => --gait: got 721; allowed: 1..720 with no failed leg
run --gait Tripot => did you mean 'tripod'?
run --gait 1,2,3,3,4,5 => --gait: got 1,2,3,3,4,5; allowed: a permutation of 1,2,3,4,5,6
run --duration -4 => --duration: got -4; allowed: above 0 up to 86400 s
run --failed-leg 7 => --failed-leg: got '7'; allowed: 1..6, several with commas such as 2,5
run --failure limp => --failure: got 'limp'; allowed: LEG:KIND such as 5:limp, 5:stuck:coxa@8
run --failure 5:mising => did you mean 'missing'?
run --failure 5:sad => --failure: got '5:sad'; allowed: locked, limp[:JOINT]
run --backend dynamixl => did you mean 'dynamixel'?
run --backend radio => --backend: got 'radio'; allowed: sim, zenoh,
run --backend mock --world rough => --world: got rough with --backend mock; allowed: with sim
run --then wave@soon => --then: got 'wave@soon'; allowed: a gait and a time in s, such as wave@10
run --recovery hope => --recovery: got 'hope'; allowed: walk-on, stop, glide, package.module:name
run --record walk.txt => --record: got walk.txt; allowed: a name that ends in .rrd
run --record a-file/walk.rrd => a-file is a file, not a folder
run --no-record --view => --no-record: got --view too; allowed: one or the other
run --recrod x => No such option: --recrod; did you mean --record?
run --frobnicate => No such option: --frobnicate; hexctl run --help-all lists the options
run --gait => --gait: got no value; hexctl run --help-all describes it
run phantomx => did you mean --robot phantomx?
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
adapt => --failed-leg: is missing; allowed: 1..6, auto (or --resume SESSION)
adapt --resume nosuch => --resume: got 'nosuch'; allowed: none yet, hexctl adapt makes one under runs/
adapt --failed-leg 5 --optimizer bays => did you mean 'bayes'?
adapt --failed-leg 5 --arena 3 => --arena: used with --backend sim
adapt --failed-leg 5 --prior nowhere.npz => --prior: no file at 'nowhere.npz'
drive => --keyboard
drive --page-keys keys => --page-keys
drive --page 0.0.0.0:0 => --page
drive --page 127.0.0.1:0 --page-keys no => --page-keys
drive --page-view http://camera/ => --page-view
drive --page 127.0.0.1:0 --page-view camera => --page-view
drive --page 127.0.0.1:0 --record full/thesis.rrd => full/thesis.rrd
drive --gamepad a-file => a-file
drive --no-record --record x.rrd => --no-record
drive --no-keyboard => --no-keyboard requires another input device; allowed: --page HOST:PORT
diagnose --backend mock --failed-leg 2 => --failed-leg
diagnose --failure 2:limp@3 => --failure
walk => No such command 'walk'. Did you mean 'run'?
check ant --robot pexod => pexod
robot copy ant => Missing argument 'FILE'; usage: hexctl robot copy
view --keys x => --keys
view a.rrd --connect tcp/127.0.0.1:1 => --connect
view /nowhere/x.rrd => recording: /nowhere/x.rrd is not there; allowed: a recording that hexctl run made
sessions show nobody => nobody
export nosuch --to csv => session
export ant -o a-file/ant.urdf => a-file is a file
export ant --to csv => export: got the robot ant for csv; allowed: urdf, mjcf, ros2, or a recording
serve --backend zenoh => --backend
serve --backend mock --failed-leg 5 => --failed-leg
serve --backend mock --world rough => --world
serve --backend mock --sit-after nan => --sit-after
serve --ros --ros-domain 999 => --ros-domain
serve --failure 5:limp@8 => --failure
serve --port /dev/null => --port
serve --backend mavlink --seed 5 => --seed
serve --ros-drive => --ros-drive
serve --ros --ros-namespace 'a b' => --ros-namespace
serve --ros tls/localhost:7447 => --ros
serve --ros --listen tcp/127.0.0.1:7447 => --listen
serve --listen banana => --listen: got 'banana'; allowed: PROTOCOL/HOST:PORT with tcp, tls or quic
serve --ros tcp/10.0.0.5:7447 => run a router here that connects to it, or give --insecure deliberately
status --watch --json => --watch
status --connect banana => --connect: got 'banana'; allowed: PROTOCOL/HOST:PORT with tcp, tls or quic
calibrate ant => ant
calibrate mine.yaml --joints leg7 => --joints
calibrate mine.yaml --page 0.0.0.0:8017 => --page: got 0.0.0.0, which other computers reach
calibrate mine.yaml --page banana => --page
calibrate mine.yaml --page-keys keys => --page-keys
servos scan --robot freenove-big => hobby servos
servos scan --driver feetech --port x --baud 9 => --baud
servos identify --model lx224 --driver feetech --port x => --model
servos set-id 300 --driver feetech --port x => 300
servos adopt --robot phantomx --port x => --driver
servos adopt --port x => --robot
servos scan --port x => --driver: got none; allowed: dynamixel, feetech, lx16a
servos scan --driver feetech => --port: got none; allowed: a serial device such as /dev/ttyUSB0
see --camera no-such.mp4 --no-link => --camera
see --camera 0 --page 0.0.0.0:8019 => --page
see calibrate a.png --camera 0 => --camera
see calibrate nowhere.png --output none/lens.yaml => --output
see --no-link => --camera: got none; allowed: a number such as 0, a device, or an address
sim camera --size 8x8 => --size
sim camera --position 1,2 => --position
sim camera --position 0,0,-1 => --position
sim camera --fault fogged@3 => --fault
sim board --port COM3 => --port
sim board --port udpin:127.0.0.1:1 --pty => --pty
sim board --port udpin:192.168.1.2:14550 => network
sim board --keys no-such-folder => no-such-folder/mavlink.key
sim board --bus hitec => hitec
sim board --bus feetech --port udpin:127.0.0.1:1 => --port
sim board --bus feetech --robot phantomx --fault noise => --fault
sim board --bus feetech --robot phantomx --model ax12a => ax12a
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
prior build --failed-leg 5 => --failed-leg; did you mean --legs?
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
prior build --duration 7 => --duration: got 7; allowed: 6 s or more, in steps of 2 s
"""

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
