"""Start the router of ROS, a robot of hexctl, RViz and Foxglove's bridge.

ros2 launch ./robot.launch.py robot:=ant
ros2 launch ./robot.launch.py robot:=mine.yaml backend:=feetech drive:=true foxglove:=true
"""

import os
from collections.abc import Mapping
from pathlib import Path

from launch import Action, LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    OpaqueFunction,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

#: Arguments with their defaults and meanings.
ARGUMENTS = {
    "robot": ("ant", "name of a shipped robot, or the path of its YAML file"),
    "backend": (
        "sim",
        "what moves: sim, mavlink, or a driver: feetech, dynamixel, lx16a, pca9685, maestro ...",
    ),
    "port": ("", "port of the servos, such as /dev/ttyUSB0:1000000; empty for that of the robot file"),
    "drive": ("false", "whether ROS may move the robot: whoever reaches the router may then drive it"),
    "namespace": ("", "namespace of the node and its topics, such as lab/ant"),
    "router": ("true", "start rmw_zenohd, the router; false if one runs"),
    "rviz": ("true", "open RViz"),
    "foxglove": ("false", "start foxglove_bridge, for the layout foxglove.json"),
}


def serve_command(given: Mapping[str, str], environment: Mapping[str, str]) -> list[str]:
    """Command of the robot, from the arguments and the ROS environment variables."""
    command = ["hexctl", "serve", "--robot", given["robot"], "--backend", given["backend"], "--ros"]
    command += ["--port", given["port"]] if given["port"] else []
    command += ["--ros-drive"] if given["drive"] == "true" else []
    command += ["--ros-namespace", given["namespace"]] if given["namespace"] else []
    domain = environment.get("ROS_DOMAIN_ID")
    command += ["--ros-domain", domain] if domain else []
    return command + (["--ros-humble"] if environment.get("ROS_DISTRO") == "humble" else [])


def _started(context: LaunchContext) -> list[Action]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    actions = [ExecuteProcess(cmd=serve_command(given, os.environ), output="screen", on_exit=Shutdown())]
    if given["router"] == "true":
        actions.insert(0, Node(package="rmw_zenoh_cpp", executable="rmw_zenohd", output="screen"))
    if given["rviz"] == "true":
        names = ("tf", "tf_static", "robot_description", "odom")
        layout = Path(__file__).parent / "robot.rviz"
        actions.append(
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=given["namespace"],
                arguments=["-d", str(layout)],
                remappings=[(f"/{name}", name) for name in names],  # into the namespace
            )
        )
    if given["foxglove"] == "true":
        actions.append(Node(package="foxglove_bridge", executable="foxglove_bridge"))
    return actions


def generate_launch_description() -> LaunchDescription:
    """What ros2 launch calls."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    middleware = SetEnvironmentVariable("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")
    return LaunchDescription([*declared, middleware, OpaqueFunction(function=_started)])
