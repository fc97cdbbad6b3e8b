"""The boundary to ROS 2: messages, parameters, QoS, diagnostics."""
