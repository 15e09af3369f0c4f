"""Walk a tripod gait with a custom controller: a function of step and state that returns 18 joint angles.

Run it with `python examples/own_controller.py`.
"""

import math

import hexctl

robot = hexctl.load_robot("ant")
standing_m = hexctl.feet_of_joint_angles(robot, robot.stance_angles_rad)  # (6, 3), in the body frame


def tripod(step, _state):
    feet_m = standing_m.copy()
    for leg in range(6):
        phase = (0.7 * 0.02 * step + leg / 2) % 1  # legs 1, 3, 5 and legs 2, 4, 6 take turns
        if phase < 0.5:  # on the floor, backward
            feet_m[leg] += 0.03 - 0.12 * phase, 0, 0
        else:  # in the air, forward
            feet_m[leg] += 0.12 * phase - 0.09, 0, 0.03 * math.sin(2 * math.pi * (phase - 0.5))
    return hexctl.joint_angles_of_feet(robot, feet_m)


print(hexctl.run(robot=robot, controller=tripod, duration_s=10, record=False).trial)
