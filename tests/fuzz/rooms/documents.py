"""Targets that are files of text: robots, worlds, links, lenses, places, measurements, stops, keys."""

import math
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from hexctl.backends.sim.world import World, load_randomization, load_world
from hexctl.control.assessment.uncertainty_store import UNCERTAINTIES, known_uncertainty
from hexctl.errors import InputError
from hexctl.robot.configs import config_root, read_mapping
from hexctl.robot.loader import load_robot_file
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
from tests.fuzz.folder import own_folder, written
from tests.fuzz.target import Target
from tests.robots import shipped

NUMBERS = (
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


def _of_file(name: str, read: Callable[[Path], object]) -> Callable[[bytes], object]:
    """A reader of bytes by way of a file of a name."""

    def of_bytes(data: bytes) -> None:
        with written(name, data) as path:
            read(path)

    return of_bytes


def _shipped(*names: str) -> tuple[bytes, ...]:
    return tuple((config_root() / f"{name}.yaml").read_bytes() for name in names)


def _bare(text: bytes) -> bytes:
    """YAML without comments."""
    return yaml.safe_dump(yaml.safe_load(text), sort_keys=False, default_flow_style=None, width=200).encode()


def _yaml(data: bytes) -> None:
    yaml_content(data.decode("utf-8"))


def _robot(path: Path) -> None:
    found = load_robot_file(path)
    robot = found.robot
    assert np.isfinite(robot.stance_angles_rad).all()
    assert math.isfinite(robot.mass_kg)
    _ = found.to_measure
    for name in ("servo_map", "raw_map", "meshes"):
        try:
            getattr(found, name)
        except InputError:
            continue


def _calibrated(path: Path) -> None:
    """Calibrate two joints of a robot file: it then says that, and all else as before."""
    found = load_robot_file(path)
    before = read_mapping(path)
    for joint in (0, 10):
        write_joint(path, found.raw_map, joint)
    after = read_mapping(path)
    assert {key: after[key] for key in before if key != SECTION} == {
        key: before[key] for key in before if key != SECTION
    }
    again = load_robot_file(path).raw_map
    assert np.array_equal(
        again.raw(found.robot.stance_angles_rad), found.raw_map.raw(found.robot.stance_angles_rad)
    )


def _settings(path: Path) -> None:
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


def _world(path: Path) -> None:
    world = load_world(path)
    assert World.model_validate(world.model_dump()) == world


def _family(path: Path) -> None:
    for world in load_randomization(path).members(0, 2):
        assert World.model_validate(world.model_dump()) == world


def _link(path: Path) -> None:
    load_link(str(path)).keys("ant")


def _lens(path: Path) -> None:
    lens = load_lens(path)
    again = path.with_name("again.yaml")
    save_lens(lens, again)
    assert np.array_equal(load_lens(again).matrix, lens.matrix)


def _place(path: Path) -> None:
    place = load_place(path)
    again = path.with_name("again.yaml")
    save_place(place, again)
    assert np.allclose(load_place(again).camera.position_m, place.camera.position_m, atol=1e-5)
    save_place(replace(place, latency_s=0.125), path)
    assert load_place(path).latency_s == 0.125


def _uncertainties(path: Path) -> None:
    known_uncertainty(shipped(), World(), folder=path.parent)


def _stop(data: bytes) -> None:
    """Load the file of a stop: whatever it holds, it is one."""
    file = StopFile("ant", "mock", "fuzz", folder=own_folder())
    with written(file.path.name, data):
        kept = file.load()
        assert kept is not None
        assert kept.stop_id == bytes.fromhex(kept.stop_id).hex()
        assert "\n" not in " ".join(file.warnings)


def _secret(path: Path) -> None:
    found = find_stop_secret(Link(credentials=path.parent), Role.ROBOT)
    assert found is not None
    assert len(found) == 32


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


def _saved(save: Callable[[Path], object]) -> bytes:
    """Content of a file that something saves."""
    path = own_folder() / "seed.yaml"
    save(path)
    return path.read_bytes()


ANT = _shipped("robots/ant")[0]

#: The same without its servos.
BARE = _bare(ANT).partition(b"servos:")[0]

LINK = (
    b"endpoint: tls/robot.local:7447\ncredentials: keys\nplain: true\n"
    b"names: {command: ant/go, pose: ant/pose}\n"
)

STOP = (
    b'{"version": 1, "robot": "ant", "reason": "estop: key", "stop_id": "0011223344556677", '
    b'"at": "2026-11-23T12:00:00Z", "backend": "mock", "where": "fuzz", "serial_number": null, '
    b'"location": null, "by": "mia"}'
)

CERTIFICATE = b"-----BEGIN CERTIFICATE-----\nMIIBszCCAVmgAwIBAgIUQ1F1\n-----END CERTIFICATE-----\n"

TARGETS = (
    Target(
        name="yaml",
        read=_yaml,
        seeds=(
            b"a: 1\nb: [1, 2.5, x]\nc: {d: &e [1], f: *e}\n",
            b"- 2026-11-23\n- !!binary aGVs\n- 1:30\n- 0x1f\n",
            b"<<: &a {b: 1}\nc: *a\n",
            b"x: |\n  text\ny: 'z'\n",
        ),
        refusals=(ValueError,),
        words=NUMBERS,
        most_bytes=500,
    ),
    Target(
        name="robot-file",
        read=_of_file("robot.yaml", _robot),
        seeds=(_bare(ANT), *map(_bare, _shipped("robots/jethexa", "robots/phantomx-ax"))),
        words=(*NUMBERS, b"driver: servo2040", b"driver: pca9685", b"driver: lx16a", b"unknown: [size_m]"),
        most_bytes=5000,
        times=10,
    ),
    Target(
        name="calibrated-file",
        read=_of_file("mine.yaml", _calibrated),
        seeds=(
            _bare(ANT),
            BARE + b"servos:  # mine\n  femur: {offset_deg: 1}\n\n  # last\n",
            BARE + b"servos: {driver: feetech, leg1_coxa: {id: 30,}, &x leg2_coxa: {id: 31}}\n",
        ),
        words=(
            *NUMBERS,
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
        most_bytes=6000,
        times=3,
    ),
    Target(
        name="world",
        read=_of_file("world.yaml", _world),
        seeds=tuple(
            map(_bare, _shipped(*(f"worlds/{name}" for name in ("flat", "failing", "rough", "slope"))))
        ),
        words=NUMBERS,
        most_bytes=1500,
        times=30,
    ),
    Target(
        name="world-family",
        read=_of_file("family.yaml", _family),
        seeds=tuple(map(_bare, _shipped("worlds/randomised", "worlds/transfer", "worlds/real"))),
        words=NUMBERS,
        most_bytes=4000,
        times=5,
    ),
    Target(
        name="settings",
        read=_of_file("hexctl.toml", _settings),
        seeds=(
            b'robot = "a.yaml"\nbackend = "sim"\nruns = "~/runs"\n[run]\nduration = 9\nfail = ["5:limp@8"]\n',
            b'connect = "tcp/a:7447"\nkeys = "keys"\n[prior.build]\nworlds = "flat"\n',
        ),
        words=(
            b"[[run]]",
            b"run = 5",
            b"prior.build = ",
            b"nan",
            b"1979-05-27",
            b'"""',
            b"~nobody/",
            b"\\u0000",
        ),
        most_bytes=400,
        times=50,
    ),
    Target(
        name="link",
        read=_of_file("link.yaml", _link),
        seeds=(LINK,),
        words=(*NUMBERS, b"insecure: ", b"lease: ", b"joint_states: "),
        most_bytes=400,
        times=50,
    ),
    Target(
        name="lens",
        read=_of_file("lens.yaml", _lens),
        seeds=(_saved(lambda path: save_lens(Lens.assumed(1280, 720, 70.0), path)),),
        words=(*NUMBERS, b"equidistant", b"rational_polynomial"),
        most_bytes=1200,
        times=20,
    ),
    Target(
        name="place",
        read=_of_file("place.yaml", _place),
        seeds=(_saved(lambda path: save_place(PLACE, path)),),
        words=(*NUMBERS, b"lens: lens.yaml"),
        most_bytes=1500,
        times=10,
    ),
    Target(
        name="uncertainty",
        read=_of_file(UNCERTAINTIES, _uncertainties),
        seeds=(
            b"measured:\n- {robot: ant, fingerprint: ab, world: {}, duration_s: 30, step_m: 1, solver_m: 0, "
            b"contact_m: 0.1, walks: 5}\n",
            b"measured:\n- {robot: ant, fingerprint: ab, time_step_s: 0.002, friction_cone: elliptic, "
            b"duration_s: 30, step_m: 0.1, solver_m: 0.2, contact_m: 0.1, walks: 5, how: 'x, in flat'}\n",
        ),
        words=NUMBERS,
        most_bytes=800,
        times=20,
    ),
    Target(
        name="stop-file",
        read=_stop,
        seeds=(STOP, b"{}"),
        words=(b"null", b"\\ud800", b"1e400"),
        most_bytes=400,
    ),
    Target(
        name="stop-secret",
        read=_of_file(SECRET_FILE, _secret),
        seeds=(b"ab" * 32 + b"\n",),
        most_bytes=200,
    ),
    Target(
        name="certificate",
        read=_of_file("certificate.pem", load_certificate),
        seeds=(CERTIFICATE,),
        words=(b"-----BEGIN", b"-----END", b"MII"),
        most_bytes=800,
    ),
)
