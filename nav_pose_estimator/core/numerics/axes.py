"""The half turns between ENU and FLU (REP-103) and the axes of autopilots, NED and FRD; each is its own inverse."""

import math

import numpy as np

FRD_FLU = np.array([1.0, -1.0, -1.0])
"""Factors (3,) of a vector's components, from FLU to FRD and back: half a turn about x."""
Q_FRD_FLU = np.array([0.0, 1.0, 0.0, 0.0])
"""Quaternion (4,), scalar first, of that turn."""
Q_NED_ENU = np.array([0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0])
"""Quaternion (4,), scalar first, from ENU to NED and back: half a turn about the axis between East and North."""
