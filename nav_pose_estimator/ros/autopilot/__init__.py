"""The way back: the pose as an autopilot takes it, and the guard against hearing it come back as GNSS."""
