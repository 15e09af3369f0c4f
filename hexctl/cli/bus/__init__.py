"""Commands about servos and their boards, one by one."""
