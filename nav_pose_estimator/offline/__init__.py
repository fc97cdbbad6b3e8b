"""Work on recorded data: bags, replay, benchmarks, reports. Never imports rclpy."""
