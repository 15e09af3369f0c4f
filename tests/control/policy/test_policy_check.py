"""`hexctl policy check` names what is wrong with a contract, and nothing of right ones."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hexctl.control.policy.policy import Policy
from hexctl.errors import InputError
from hexctl.robot.sensors import SENSORS
from hexctl.runs.policy_check import check_policy
from hexctl.runs.run_spec import RunSpec
from tests.control.policy import networks
from tests.control.policy.networks import BY_KIND, OWN
from tests.robots import shipped

#: A walk that uses all of its terms, so that mistakes about them matter.
ALIVE = replace(
    OWN,
    feedback={"joint_vel": -0.01, "joint_pos_rel": -0.1, "projected_gravity": 0.3, "base_ang_vel": 0.02},
)

#: A change of a right contract.
Change = Callable[[dict[str, Any]], dict[str, Any]]


def findings(folder: Path, change: Change = lambda right: right, *, stem: str = "own") -> list[str]:
    """What a check finds in a changed contract; a refusal is found, too."""
    path = folder / f"{stem}.onnx"
    content = yaml.safe_load((folder / f"{stem}.yaml").read_text())
    networks.write_yaml(folder / f"{stem}.yaml", change(content))
    robot = replace(shipped(), sensors=SENSORS)
    try:
        return list(check_policy(Policy.load(path), robot, RunSpec(duration_s=6.0)).findings)
    except InputError as error:
        return [str(error)]


def with_term(name: str, **keys: Any) -> Change:
    return lambda right: (
        right
        | {"observations": [term | keys if term["name"] == name else term for term in right["observations"]]}
    )


def renamed(names: dict[str, str]) -> Change:
    return lambda right: right | {"joints": [names.get(name, name) for name in right["joints"]]}


def with_action(**keys: Any) -> Change:
    return lambda right: right | {"action": right["action"] | keys}


def swapped(first: int, second: int) -> Change:
    """Two terms in each other's place."""

    def change(right: dict[str, Any]) -> dict[str, Any]:
        terms = list(right["observations"])
        terms[first], terms[second] = terms[second], terms[first]
        return right | {"observations": terms}

    return change


def by_leg(right: dict[str, Any]) -> dict[str, Any]:
    """Joints leg by leg, of a network that has them kind by kind."""
    signed = {name.removeprefix("-"): name for name in right["joints"]}
    return right | {"joints": [signed[name] for name in sorted(BY_KIND, key=lambda name: name[3])]}


WRONG: dict[str, Change] = {
    "order: leg by leg": by_leg,
    "order: two legs": renamed(
        {
            **{f"leg2_{kind}": f"leg3_{kind}" for kind in ("coxa", "femur", "tibia")},
            **{f"leg3_{kind}": f"leg2_{kind}" for kind in ("coxa", "femur", "tibia")},
        }
    ),
    "order: femur and tibia of a leg": renamed({"leg2_femur": "leg2_tibia", "leg2_tibia": "leg2_femur"}),
    "direction: a tibia": renamed({"-leg4_tibia": "leg4_tibia"}),
    "direction: a femur": renamed({"-leg1_femur": "leg1_femur"}),
    "direction: a coxa": renamed({"leg5_coxa": "-leg5_coxa"}),
    "direction: all coxae": renamed({f"leg{leg}_coxa": f"-leg{leg}_coxa" for leg in range(1, 7)}),
    "scale of actions: 10 times": with_action(scale=2.5),
    "scale of actions: a tenth": with_action(scale=0.025),
    "offset: 0": with_action(offset_rad=0.0),
    "unit of the default pose": lambda right: (
        right | {"default_rad": [float(np.degrees(one)) for one in right["default_rad"]]}
    ),
    "rate: 100 Hz": lambda right: right | {"control_hz": 100},
    "rate: missing": lambda right: {key: value for key, value in right.items() if key != "control_hz"},
    "normaliser: other size": lambda right: right | {"normaliser": {"mean": [0.0] * 9, "std": [1.0] * 9}},
    "scale of joint velocities": with_term("joint_vel", scale=1.0),
    "unit of the rate of the body": with_term("base_ang_vel", scale=0.25 * 57.3),
    "unit of gravity": with_term("projected_gravity", scale=9.81),
    "direction of gravity": with_term("projected_gravity", scale=-1.0),
    "a term too few": lambda right: right | {"observations": right["observations"][1:]},
    "order of terms": swapped(2, 4),
    "a history": with_term("command", history=2),
    "period of the phase": with_term("gait_phase", period_s=3 * networks.gaiter().period_s),
    "scale of the command": with_term("command", scale=0.1),
    "a zero of a joint": lambda right: right | {"zeros_rad": {"leg3_femur": 0.6}},
}


#: Mistakes that this walk survives: legs 2 and 3 of ant are alike, and terms of one size are both small.
MISSED = ("order: two legs", "order of terms")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.xfail(strict=True)] if name in MISSED else []) for name in WRONG],
)
def test_a_wrong_contract_is_refused_or_named(name: str, tmp_path: Path) -> None:
    networks.own(tmp_path, layout=ALIVE)
    assert findings(tmp_path, WRONG[name])


@pytest.mark.slow
def test_a_missing_normaliser_is_named(tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    mean, std = random.normal(size=OWN.size), random.uniform(0.2, 3, OWN.size)
    networks.own(tmp_path, layout=ALIVE)
    normalised = networks.write_onnx(tmp_path / "own.onnx", networks.gaiter(), ALIVE, mean=mean, std=std)
    assert findings(tmp_path) == [], "in the graph"
    import onnx

    model = onnx.load(normalised)
    del model.graph.node[:2]
    for node in model.graph.node:
        node.input[:] = ["obs" if one == "normal" else one for one in node.input]
    onnx.save(model, normalised)
    outside = {"mean": mean.tolist(), "std": std.tolist()}
    assert findings(tmp_path, lambda right: right | {"normaliser": outside}) == []
    assert findings(tmp_path, lambda right: right | {"normaliser": "none"})


@pytest.mark.slow
@pytest.mark.parametrize("maker", [*networks.MAKERS, "alive"])
def test_nothing_is_found_in_a_right_contract(maker: str, tmp_path: Path) -> None:
    if maker == "alive":
        networks.own(tmp_path, layout=ALIVE)
    else:
        networks.MAKERS[maker](tmp_path)
    assert findings(tmp_path, stem="own" if maker == "alive" else maker) == []
