"""The keys of a robot on Zenoh: the one place that names them."""

from dataclasses import dataclass, fields, replace

from hexctl.errors import InputError

#: First part of every key of hexctl's own naming.
ROOT = "hexctl"


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyMap:
    """Where each kind of message travels; every value is a full key expression.

    Attributes:
        command: joint targets to the robot, sensor_msgs/JointState.
        joint_states: joint angles from the robot, sensor_msgs/JointState.
        odom: pose from the robot, nav_msgs/Odometry.
        battery: sensor_msgs/BatteryState.
        status: what the robot says of itself, JSON.
        pose: a pose for the robot that does not know its own (motion capture), nav_msgs/Odometry.
        describe: queryable: robot description, protocol version, joint order, JSON.
        lease: queryable: who may command, JSON.
        estop: queryable: stop, or clear a stop, JSON.
    """

    command: str
    joint_states: str
    odom: str
    battery: str
    status: str
    pose: str
    describe: str
    lease: str
    estop: str

    @classmethod
    def of(cls, robot_name: str) -> "KeyMap":
        """Return hexctl's own keys of a robot: `hexctl/<robot>/<kind>`."""
        return cls(**{kind: f"{ROOT}/{robot_name}/{kind}" for kind in KINDS})

    def renamed(self, names: dict[str, str]) -> "KeyMap":
        """Return the map with some kinds under other keys, for a robot that has names of its own.

        Raises InputError for a kind that does not exist, a key that Zenoh does not take, or two kinds under
        one key.
        """
        for kind, key in names.items():
            if kind not in KINDS:
                raise InputError(f"keys: got {kind!r}; allowed: {', '.join(KINDS)}")
            _check_key(kind, key)
        renamed = replace(self, **names)
        taken: dict[str, str] = {}
        for kind in KINDS:
            key = getattr(renamed, kind)
            if key in taken:
                raise InputError(f"keys: got {key!r} for {taken[key]} and {kind}; allowed: a key each")
            taken[key] = kind
        return renamed


KINDS = tuple(field.name for field in fields(KeyMap))


def _check_key(kind: str, key: str) -> None:
    """Refuse what is not one plain Zenoh key: empty parts, wildcards, and the characters it reserves."""
    parts = key.split("/")
    if not all(parts) or any(sign in key for sign in "*$?#@ "):
        raise InputError(
            f"keys: got {key!r} for {kind}; allowed: names joined by single slashes, none of * $ ? # @"
        )
