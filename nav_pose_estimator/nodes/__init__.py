"""ROS 2 nodes: convert, feed, publish."""
