"""Where each quantity lives in the state vector of an attitude filter; both filters share this head.

One float64 vector holds estimate, memory and tuning constants of a filter: a compiled step takes one array, an output
is one copy of the head, and a snapshot is one copy of the whole.
"""

QUAT = 0  # 4: q_nb, scalar first
COV = 4  # 9: covariance of the misalignment about n axes, row-major, rad^2
RATE = 13  # 3: bias-corrected angular rate in b, rad/s
FORCE = 16  # 3: specific force in b, m/s^2
BIAS = 19  # 3: gyro bias in b, rad/s
HEAD_SIZE = 22
"""The head: all that an attitude solution reports."""
