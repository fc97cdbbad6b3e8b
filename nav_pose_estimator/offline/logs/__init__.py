"""Flight logs of autopilots, PX4 ULog and ArduPilot DataFlash, read directly into recordings."""
