"""A leg fails in mid-walk and the robot walks on without it: `hexctl.demo.rescue.demo()`."""
