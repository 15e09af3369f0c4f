"""Who may do what on a robot's session: nothing, unless a rule says so. Zenoh enforces it per certificate."""

from typing import Any

from hexctl.wire.keys import ROOT, KeyMap
from hexctl.wire.role import Role

#: What a robot publishes, what it is told, what it answers.
SAID = ("joint_states", "odom", "battery", "status")
HEARD = ("command", "pose")
ANSWERED = ("describe", "lease", "estop")

#: Asked of whatever robot is on a link: its name need not be known.
ASKED_OF_ANY = ("describe", "estop")


def access_control(keys: KeyMap, *, certified: bool) -> dict[str, Any]:
    """Return the `access_control` section of a robot's Zenoh configuration.

    Without certificates everybody is a controller: a subject without properties is anybody.

    Controllers and viewers get what the robot says and may ask who it is; only controllers may command, say
    where it is, and ask for lease and stop. Nobody but the robot may say anything in its name, or answer.
    """
    looking = [
        _rule("says", "egress", ["put"], _keys(keys, SAID)),
        _rule("is listened to", "ingress", ["declare_subscriber"], _keys(keys, SAID)),
        _rule("offers answers", "egress", ["declare_queryable", "reply"], _keys(keys, ANSWERED)),
        _rule("wants to hear", "egress", ["declare_subscriber"], _keys(keys, HEARD)),
        _rule("is asked who it is", "ingress", ["query"], _asked(keys, ("describe",))),
    ]
    commanding = [
        _rule("is commanded", "ingress", ["put"], _keys(keys, HEARD)),
        _rule("is asked", "ingress", ["query"], _asked(keys, ANSWERED)),
    ]
    allowed = {Role.CONTROLLER: looking + commanding}
    if certified:
        allowed[Role.VIEWER] = looking
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": looking + commanding,
        "subjects": [
            {"id": role.value, **({"cert_common_names": [role.value]} if certified else {})}
            for role in allowed
        ],
        "policies": [
            {"rules": [rule["id"] for rule in rules], "subjects": [role.value]}
            for role, rules in allowed.items()
        ],
    }


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}


def _keys(keys: KeyMap, kinds: tuple[str, ...]) -> list[str]:
    return [getattr(keys, kind) for kind in kinds]


def _asked(keys: KeyMap, kinds: tuple[str, ...]) -> list[str]:
    """Return the keys of a robot's answers, and the expressions that ask any robot."""
    return _keys(keys, kinds) + [f"{ROOT}/*/{kind}" for kind in kinds if kind in ASKED_OF_ANY]
