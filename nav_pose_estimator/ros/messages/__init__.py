"""ROS messages to samples and solutions to messages; free of rclpy."""
