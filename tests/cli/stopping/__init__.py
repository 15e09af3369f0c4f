"""How fast a robot that is driven comes to rest: real causes, measured at its servos."""
