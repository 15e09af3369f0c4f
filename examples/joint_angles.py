"""Drive a simulated robot forward for four seconds and print the angles of leg 1.

Run it with `python examples/joint_angles.py`. With `Drive("mine.yaml", backend="zenoh")` the same program
reads a robot behind `hexctl serve`.
"""

import numpy as np

from hexctl import Drive

with Drive("ant") as robot:
    robot.reset()  # stands up
    robot.command(forward_m_s=0.1)
    for step in range(200):  # 50 steps a second
        state = robot.step()
        if step % 50 == 49:
            coxa, femur, tibia = np.degrees(state.joint_positions_rad[:3])
            print(f"{state.stamp_s:.2f} s: coxa {coxa:.1f}, femur {femur:.1f}, tibia {tibia:.1f} degrees")
