"""A leg fails during a walk and the robot continues without it: `hexctl.demo.rescue.demo()`."""
