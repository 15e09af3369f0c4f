"""Frames of a robot in ROS, as REP 105 has them: `odom` drifts and does not jump, `map` may jump."""

from hexctl.robot.model import Robot
from hexctl.robot.rotations import about_z, inverse, product, turned, yaw_rad
from hexctl.serve.ros.dead_reckoning import BodyPose, DeadReckoning
from hexctl.serve.ros.snapshot import RobotSnapshot
from hexctl.types import FloatArray

MAP_FRAME = "map"


class Frames:
    """Where a robot is in `odom`, and `odom` in `map`.

    A robot with a pose of its own has no `map`: that pose is the one in `odom`. A pose from outside is the
    one in `map`, and the one in `odom` is dead reckoning, which goes on where the robot's own pose ended. It
    begins with the first subscriber, as it takes half a millisecond of each control period, and then never
    pauses: who subscribes again finds the frame where it was.

    Args:
        robot: geometry and masses.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._own: RobotSnapshot | None = None
        self._reckoning: DeadReckoning | None = None
        self._body: BodyPose | None = None
        self._odom: BodyPose | None = None
        self._posed_at_s: float | None = None

    def follow(self, snapshot: RobotSnapshot, *, wanted: bool) -> None:
        """Take in a state, each of them.

        Args:
            snapshot: of the robot.
            wanted: whether anything subscribes to where the robot is.
        """
        if snapshot.posed_at_s is None:
            self._own = snapshot
            return
        if self._reckoning is None and wanted:
            self._reckoning = self._begun()
        if self._reckoning is None:
            return
        self._body = self._reckoning.update(snapshot.state, snapshot.orientation)
        pose = BodyPose.of(snapshot.state)
        if pose is not None and snapshot.posed_at_s != self._posed_at_s:
            self._odom = _parent(pose, self._body, has_tilt=snapshot.orientation is not None)
            self._posed_at_s = snapshot.posed_at_s
            self._reckoning.see(snapshot.state.stamp_s, pose)

    def body_in_odom(self, snapshot: RobotSnapshot) -> BodyPose | None:
        """Pose of `base_link` in `odom`, None where it is not known."""
        return BodyPose.of(snapshot.state) if snapshot.posed_at_s is None else self._body

    def odom_in_map(self, snapshot: RobotSnapshot) -> BodyPose | None:
        """Pose of `odom` in `map`, None where there is no `map`.

        It changes with each pose from outside, and stays while none comes.
        """
        return None if snapshot.posed_at_s is None else self._odom

    def _begun(self) -> DeadReckoning:
        own = self._own
        if own is None:
            return DeadReckoning(self._robot)
        begun = DeadReckoning(self._robot, BodyPose.of(own.state))
        begun.update(own.state, own.orientation)
        return begun


def _parent(pose: BodyPose, body: BodyPose, *, has_tilt: bool) -> BodyPose:
    """Pose in `map` of the frame in which a body is at `body`, while it is at `pose` in `map`.

    An orientation that is exactly level is that of something which does not see roll and pitch, such as a
    camera: these stay as the robot measures them, if it does, and the frame does not sway with them.
    """
    level = not pose.quaternion[1:3].any()
    if level and has_tilt:
        turn: FloatArray = about_z(float(yaw_rad(pose.quaternion) - yaw_rad(body.quaternion)))
    else:
        turn = product(pose.quaternion, inverse(body.quaternion))
    return BodyPose(pose.position_m - turned(turn, body.position_m), turn)
