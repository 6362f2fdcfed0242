"""A sensor in ROS 2: messages, a bridge without a ROS install (zenoh), an rclpy node, URDF frames. See README.md."""
