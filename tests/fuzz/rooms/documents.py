"""Targets that are files: robots, their shapes, worlds, links, lenses, places, measurements, stops, keys."""

import json
import math
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from hexctl.backends.registry import raw_map_of
from hexctl.backends.sim.world import World, load_randomization, load_world
from hexctl.control.scoring.uncertainty_store import UNCERTAINTIES, known_uncertainty
from hexctl.errors import HexctlError, InputError
from hexctl.identify.bench_run import plain_start, read_bench_run
from hexctl.robot.configs import config_root, read_mapping
from hexctl.robot.formats.importing import urdf_tree
from hexctl.robot.formats.importing.mjcf_files import check_mjcf_files
from hexctl.robot.formats.importing.robot_import import import_robot
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.loader import load_robot_file
from hexctl.robot.meshes import GLB_HEAD, MEDIA_TYPES, check_mesh
from hexctl.robot.servos.servos_section import SECTION, write_joint
from hexctl.robot.yaml_text import yaml_content
from hexctl.server.stops.stop_file import StopFile
from hexctl.settings import CHOSEN, read_settings
from hexctl.vision.detection.lens import Lens, load_lens, save_lens
from hexctl.vision.place import (
    AssumedLens,
    CameraPose,
    FloorTag,
    Place,
    RobotTag,
    load_place,
    save_place,
)
from hexctl.wire.certificates import load_certificate
from hexctl.wire.links import Link, Role, load_link
from hexctl.wire.stop_datagram import SECRET_FILE, find_stop_secret
from tests.fuzz.target import JSON_WORDS, NUMBERS, own_folder, target, written
from tests.robots import shipped

YAML_WORDS = (
    b".nan",
    b".inf",
    b"1e400",
    b"0x" + b"f" * 60,
    b"1:" * 30,
    b"~",
    b"yes",
    b"[]",
    b"{}",
    b"''",
    b"&a ",
    b"*a",
    b"<<: ",
    b"!!int ",
    b"!!binary ",
    b"!!timestamp ",
    b"? ",
    b"- ",
    b": ",
    b"|\n ",
    b"%YAML 1.1\n",
)


def _shipped(*names: str) -> tuple[bytes, ...]:
    return tuple((config_root() / f"{name}.yaml").read_bytes() for name in names)


def _bare(text: bytes) -> bytes:
    """YAML without comments."""
    return yaml.safe_dump(yaml.safe_load(text), sort_keys=False, default_flow_style=None, width=200).encode()


def _saved(save: Callable[[Path], object]) -> bytes:
    """Content of a file that something saves."""
    path = own_folder() / "seed.yaml"
    save(path)
    return path.read_bytes()


ANT = _shipped("robots/ant")[0]

#: The same without its servos.
BARE = _bare(ANT).partition(b"servos:")[0]


@target(
    b"a: 1\nb: [1, 2.5, x]\nc: {d: &e [1], f: *e}\n",
    b"- 2026-11-23\n- !!binary aGVs\n- 1:30\n- 0x1f\n",
    b"<<: &a {b: 1}\nc: *a\n",
    b"x: |\n  text\ny: 'z'\n",
    refusals=(ValueError,),
    words=YAML_WORDS,
)
def read_yaml(data: bytes) -> None:
    yaml_content(data.decode("utf-8"))


@target(
    _bare(ANT),
    *map(_bare, _shipped("robots/jethexa", "robots/phantomx-ax")),
    given=partial(written, "robot.yaml"),
    words=(*YAML_WORDS, b"driver: servo2040", b"driver: pca9685", b"driver: lx16a", b"unknown: [size_m]"),
    times=10,
)
def read_robot_file(path: Path) -> None:
    found = load_robot_file(path)
    robot = found.robot
    assert np.isfinite(robot.stance_angles_rad).all()
    assert math.isfinite(robot.mass_kg)
    _ = found.to_measure
    for look in (lambda: found.servo_map, lambda: found.meshes, lambda: raw_map_of(found)):
        with suppress(InputError):
            look()


@target(
    _bare(ANT),
    BARE + b"servos:  # mine\n  femur: {offset_deg: 1}\n\n  # last\n",
    BARE + b"servos: {driver: feetech, leg1_coxa: {id: 30,}, &x leg2_coxa: {id: 31}}\n",
    given=partial(written, "mine.yaml"),
    words=(
        *YAML_WORDS,
        b"servos:",
        b"leg1_coxa: ",
        b"  # note\n",
        b"\xe2\x80\xa8",
        b"\x0c",
        b"\t",
        b"\r\n",
        b"---\n",
        b"...\n",
    ),
    times=3,
)
def read_calibrated_file(path: Path) -> None:
    """Calibrate two joints of a robot file: it then says that, and all else as before."""
    found = load_robot_file(path)
    before = read_mapping(path)
    for joint in (0, 10):
        write_joint(path, raw_map_of(found), joint)
    after = read_mapping(path)
    for key in set(before) - {SECTION}:
        assert after[key] == before[key]
    again = raw_map_of(load_robot_file(path))
    assert np.array_equal(
        again.raw(found.robot.stance_angles_rad), raw_map_of(found).raw(found.robot.stance_angles_rad)
    )


@target(
    *map(_bare, _shipped("worlds/flat", "worlds/failing", "worlds/rough", "worlds/slope")),
    given=partial(written, "world.yaml"),
    words=YAML_WORDS,
    times=30,
)
def read_world(path: Path) -> None:
    world = load_world(path)
    assert World.model_validate(world.model_dump()) == world


@target(
    *map(_bare, _shipped("worlds/randomised", "worlds/transfer", "worlds/real")),
    given=partial(written, "family.yaml"),
    words=YAML_WORDS,
    times=5,
)
def read_world_family(path: Path) -> None:
    for world in load_randomization(path).members(0, 2):
        assert World.model_validate(world.model_dump()) == world


@target(
    b'robot = "a.yaml"\nbackend = "sim"\nruns = "~/runs"\n[run]\nduration = 9\nfail = ["5:limp@8"]\n',
    b'connect = "tcp/a:7447"\nkeys = "keys"\n[prior.build]\nworlds = "flat"\n',
    given=partial(written, "hexctl.toml"),
    words=(b"[[run]]", b"run = 5", b"prior.build = ", b"nan", b"1979-05-27", b'"""', b"~nobody/", b"\\u0000"),
    times=50,
)
def read_settings_file(path: Path) -> None:
    """Read settings, and use those of the robot and of commands."""
    before = os.environ.get(CHOSEN)
    os.environ[CHOSEN] = str(path)
    try:
        settings = read_settings(path.parent)
    finally:
        del os.environ[CHOSEN]
        if before is not None:
            os.environ[CHOSEN] = before
    _ = settings.values, settings.origins, settings.runs
    settings.of("run")
    settings.of("prior", "build")
    settings.find(("prior", "build", "worlds"), ("robot",))


@target(
    b"endpoint: tls/robot.local:7447\ncredentials: keys\nplain: true\n"
    b"names: {command: ant/go, pose: ant/pose}\n",
    given=partial(written, "link.yaml"),
    words=(*YAML_WORDS, b"insecure: ", b"lease: ", b"joint_states: "),
    times=50,
)
def read_link(path: Path) -> None:
    load_link(str(path)).keys("ant")


@target(
    _saved(partial(save_lens, Lens.assumed(1280, 720, 70.0))),
    given=partial(written, "lens.yaml"),
    words=(*YAML_WORDS, b"equidistant", b"rational_polynomial"),
    times=20,
)
def read_lens(path: Path) -> None:
    lens = load_lens(path)
    again = path.with_name("again.yaml")
    save_lens(lens, again)
    assert np.array_equal(load_lens(again).matrix, lens.matrix)


PLACE = Place(
    assumed_lens=AssumedLens(width_px=1280, height_px=720, fov_deg=70.0),
    camera=CameraPose(position_m=(0.5, 0.2, 2.0), orientation=(0.0, 1.0, 0.0, 0.0), picture_px=(1280, 720)),
    floor_tags={
        0: FloorTag(edge_mm=100, x_m=0, y_m=0, yaw_deg=0),
        1: FloorTag(edge_mm=100, x_m=1, y_m=0.5, yaw_deg=12),
    },
    robot_tag=RobotTag(id=5, edge_mm=60, height_m=0.08),
    latency_s=0.1,
)


@target(
    _saved(partial(save_place, PLACE)),
    given=partial(written, "place.yaml"),
    words=(*YAML_WORDS, b"lens: lens.yaml"),
    times=10,
)
def read_place(path: Path) -> None:
    place = load_place(path)
    again = path.with_name("again.yaml")
    save_place(place, again)
    assert np.allclose(load_place(again).camera.position_m, place.camera.position_m, atol=1e-5)
    save_place(replace(place, latency_s=0.125), path)
    assert load_place(path).latency_s == 0.125


@target(
    b"measured:\n- {robot: ant, fingerprint: ab, world: {}, duration_s: 30, step_m: 1, solver_m: 0, "
    b"contact_m: 0.1, walks: 5}\n",
    b"measured:\n- {robot: ant, fingerprint: ab, time_step_s: 0.002, friction_cone: elliptic, "
    b"duration_s: 30, step_m: 0.1, solver_m: 0.2, contact_m: 0.1, walks: 5, how: 'x, in flat'}\n",
    given=partial(written, UNCERTAINTIES),
    words=YAML_WORDS,
    times=20,
)
def read_uncertainty(path: Path) -> None:
    known_uncertainty(shipped(), World(), folder=path.parent)


@target(
    b'{"version": 1, "robot": "ant", "reason": "estop: key", "stop_id": "0011223344556677", '
    b'"at": "2026-11-23T12:00:00Z", "backend": "mock", "where": "fuzz", "serial_number": null, '
    b'"location": null, "by": "mia"}',
    b"{}",
    words=(b"null", b"\\ud800", b"1e400"),
)
def read_stop_file(data: bytes) -> None:
    """Load the file of a stop: whatever it holds, it is one."""
    file = StopFile("ant", "mock", "fuzz", folder=own_folder())
    written(file.path.name, data)
    kept = file.load()
    assert kept is not None
    assert kept.stop_id == bytes.fromhex(kept.stop_id).hex()
    assert "\n" not in " ".join(file.warnings)


@target(b"ab" * 32 + b"\n", given=partial(written, SECRET_FILE))
def read_stop_secret(path: Path) -> None:
    found = find_stop_secret(Link(credentials=path.parent), Role.ROBOT)
    assert found is not None
    assert len(found) == 32


@target(
    b"-----BEGIN CERTIFICATE-----\nMIIBszCCAVmgAwIBAgIUQ1F1\n-----END CERTIFICATE-----\n",
    given=partial(written, "certificate.pem"),
    words=(b"-----BEGIN", b"-----END", b"MII"),
)
def read_certificate(path: Path) -> None:
    load_certificate(path)


TREE = b"""<robot name="a"><link name="b"><visual><origin xyz="0 0 1" rpy="0 1 0"/><geometry>
<mesh filename="m.stl" scale="1 1 1"/></geometry></visual><inertial><mass value="1"/></inertial></link>
<link name="c"><collision><geometry><box size="1 2 3"/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="2" velocity="3"/></joint></robot>"""


@target(
    TREE,
    given=partial(written, "tree.urdf"),
    words=(*NUMBERS, b"<joint", b"<link", b"<!ENTITY", b"<!DOCTYPE", b"${", b"<origin", b"<axis"),
)
def read_urdf_tree(path: Path) -> None:
    tree = urdf_tree.read_urdf(path)
    for link in tree.links:
        assert np.asarray(tree.frame_in_root(link)).shape == (4, 4)
        tree.hinges(link)
        tree.rigid(link)


@target(
    urdf_of(shipped()).encode(),
    urdf_of(shipped("pexod")).encode(),
    given=partial(written, "robot.urdf"),
    words=(*NUMBERS, b"0 0 0", b"fixed", b"continuous", b"prismatic"),
    times=3,
)
def read_urdf(path: Path) -> None:
    """Import a URDF; the robot file that comes out is a good one, or refused in one line."""
    imported = written("imported.yaml", import_robot(path).text.encode())
    with suppress(HexctlError):
        load_robot_file(imported)


MJCF_WORDS = (
    *NUMBERS,
    b'<replicate count="9">',
    b"</replicate>",
    b'<include file="robot.xml"/>',
    b'<model name="m" file="robot.xml"/>',
    b'<attach model="m"/>',
    b"<!--",
    b"-->",
    b'<geom type="mesh" mesh="m"/>',
    b"mass=",
)


@target(
    mjcf_of(shipped()).encode(),
    b'<mujoco><replicate count="3"><geom/></replicate><include file="a"/><hfield nrow="2"/></mujoco>',
    given=partial(written, "robot.xml"),
    refusals=(ValueError, OSError),
    words=MJCF_WORDS,
)
def read_mjcf_files(path: Path) -> None:
    """Check what an MJCF asks of MuJoCo."""
    check_mjcf_files(path)


@target(
    mjcf_of(shipped()).encode(),
    given=partial(written, "robot.xml"),
    words=MJCF_WORDS,
    times=2,
)
def read_mjcf(path: Path) -> None:
    """Import an MJCF, which MuJoCo compiles in a child; the robot file is good, or refused in one line."""
    imported = written("imported.yaml", import_robot(path).text.encode())
    with suppress(HexctlError):
        load_robot_file(imported)


@target(
    b'{"mass": 0.9, "length": 0.15, "kp": 32, "arm_mass": 0.1, "entries": ['
    + b",".join(b'{"timestamp": %d.5, "position": 0.01, "goal_position": 0.2}' % n for n in range(3))
    + b"]}",
    json.dumps(
        {
            "mass": 0.9,
            "length": 0.15,
            "kp": 32,
            "entries": [{"timestamp": 0.02 * n, "position": 0.0, "goal_position": 0.1} for n in range(12)],
        }
    ).encode(),
    given=partial(written, "run.json"),
    words=(*JSON_WORDS, b'"torque_enable": false', b'"timestamp": '),
)
def read_bench(path: Path) -> None:
    run = read_bench_run(path)
    assert np.isfinite(run.measured_rad).all()
    assert np.isfinite(run.errors_rad(plain_start([run]))[:1]).all()


@target(
    bytes(80) + (1).to_bytes(4, "little") + bytes(50),
    GLB_HEAD.pack(b"glTF", 2, GLB_HEAD.size),
    b"v 0 0 0\nv 0 0 1\nv 0 1 0\nf 1 2 3\n",
    b"solid a\nvertex 0 0 0\nendsolid",
    words=(b"\nv ", b"\nf ", b"glTF"),
)
def read_mesh(data: bytes) -> None:
    for kind in MEDIA_TYPES.values():
        with suppress(HexctlError):
            check_mesh(data, kind)
