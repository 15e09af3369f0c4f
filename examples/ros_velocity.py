"""Walk a robot forward for three seconds from a ROS 2 computer, with `cmd_vel`.

Serve a robot that ROS may drive, `hexctl serve --ros --ros-drive`, and start `ros2 run rmw_zenoh_cpp
rmw_zenohd`. On the ROS computer: `RMW_IMPLEMENTATION=rmw_zenoh_cpp python3 ros_velocity.py`.
"""

import time

import rclpy
from geometry_msgs.msg import Twist

rclpy.init()
node = rclpy.create_node("forward")
publisher = node.create_publisher(Twist, "cmd_vel", 10)

velocity = Twist()
velocity.linear.x = 0.1  # m/s
end_s = time.monotonic() + 3.0
while time.monotonic() < end_s:
    publisher.publish(velocity)  # a command expires after half a second
    time.sleep(0.1)

publisher.publish(Twist())  # zero: stop
time.sleep(0.1)
node.destroy_node()
rclpy.shutdown()
