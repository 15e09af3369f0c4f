"""ROS 2 over Zenoh, compatible with rmw_zenoh: names, attachments, messages and sessions, without ROS."""
