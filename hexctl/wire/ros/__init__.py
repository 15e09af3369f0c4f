"""ROS 2 over Zenoh, as rmw_zenoh speaks it: names, attachments, messages and sessions, without ROS itself."""
