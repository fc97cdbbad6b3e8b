"""Where each quantity lives in the state vector of an attitude filter. Code uses these names, never numbers.

One float64 vector holds estimate, memory and tuning constants of a filter: a compiled step takes one array, an output
is one copy of the head, and a snapshot is one copy of the whole. Both filters share this layout; each appends its own
covariance from ``OWN`` on.
"""

# --- head: all that an attitude solution reports -------------------------------------------------------------------
QUAT = 0  # 4: q_nb, scalar first
COV = 4  # 9: covariance of the misalignment about n axes, row-major, rad^2
RATE = 13  # 3: corrected angular rate in b, rad/s
FORCE = 16  # 3: specific force in b, m/s^2
BIAS = 19  # 3: gyro bias in b, rad/s
HEAD_SIZE = 22
BLOCK_QUAT, BLOCK_TILT_VAR, BLOCK_YAW_VAR, BLOCK_BIAS, BLOCK_COLUMNS = 0, 4, 5, 6, 9
"""Rows of a batch: attitude (4), larger variance of tilt, variance of heading [rad^2], gyro bias (3)."""
# --- estimate ------------------------------------------------------------------------------------------------------
AGE = 22  # s since the first sample, negative before it
MATRIX = 23  # 9: row-major M in w_measured = (I + M) w + bias
SWAY = 32  # 3: velocity in n that specific force less gravity builds up; only tilt or motion can make it grow, m/s
SWAY_LOW = 35  # 2: low-passed horizontal sway: what lasts, m/s
SWAY_VAR = 37  # smoothed mean square of SWAY_LOW, per axis, (m/s)^2
# --- sums since the last feedback ----------------------------------------------------------------------------------
SUM_TIME = 38  # s
SUM_RATE = 39  # 3: raw rate, rad
SUM_FORCE = 42  # 3: raw force in b, m/s
SUM_RATE_SQUARE = 45  # rad^2/s
SUM_FORCE_SQUARE = 46  # m^2/s^3
SUM_TURN = 47  # 3: corrected rate, rad
SUM_FORCE_N = 50  # 3: force in n, m/s
SUM_FIELD = 53  # 3: magnetic field in n
SUM_WALK = 56  # rad^2 per axis: walk of the attitude
FIELD_COUNT = 57  # samples in SUM_FIELD
COLUMNS = 58  # 9: columns of C_nb at the last feedback
# --- rest and rejection --------------------------------------------------------------------------------------------
MEAN_RATE = 67  # 3: smoothed raw rate, rad/s
MEAN_FORCE = 70  # 3: smoothed raw force, m/s^2
STILL_TIME = 73  # s without motion
LOW_FORCE = 74  # 3: low-passed force in n, m/s^2
TRUST = 77  # p(a), 0 ... 1
MOTION = 78  # smoothed norm of the rate, rad/s
# --- the navigator's acceleration ----------------------------------------------------------------------------------
NAV_ACCEL = 79  # 3: m/s^2, n
NAV_HOLD = 82  # s for which it is still believed
NAV_SPEED = 83  # m/s, negative when unknown
# --- magnetic field ------------------------------------------------------------------------------------------------
FIELD_H = 84  # learned horizontal part, 0 before the first sample
FIELD_V = 85  # learned downward part
FIELD_SUPPORT = 86  # s of field that speak for them
FIELD_ANOMALY = 87  # smoothed squared distance from them, relative to FIELD_H
FIELD_TRUST = 88  # 0 disturbed ... 1 undisturbed
FIELD_TIME = 89  # AGE at the last field observation
NEW_H = 90  # the field of the last seconds, a candidate for FIELD_H ...
NEW_V = 91  # ... and FIELD_V
NEW_ANOMALY = 92  # smoothed squared distance from the candidate
NEW_SUPPORT = 93  # s of field that speak for the candidate
FIELD_CHANGES = 94  # how often a candidate replaced the reference
# --- what the engine tells about the sensors -----------------------------------------------------------------------
EXTRA_PSD = 95  # rad^2/s: additional walk of the attitude while the gyroscope is saturated or stuck
EXTRA_SWAY_PSD = 96  # (m/s^2)^2/Hz: additional noise of the force while the accelerometer is saturated
FROZEN = 97  # 1 while a sensor is stuck: stillness proves nothing, and force says nothing
SUM_SWEEP = 98  # 3: how the field of SUM_FIELD changes with the rate, w x m in n: what a second of delay adds to it
MAG_DELAY = 101  # s: the magnetometer behind the gyroscope
MAG_DELAY_VAR = 102  # s^2
FIELD_TURN = 103  # rad turned since the heading was taken from the field: independent views of it
COMPASS_OFFSET = 104  # rad: error of a magnetic heading against the navigator's, learned while that one is good
OFFSET_SUPPORT = 105  # s that speak for it
NAV_HEADING = 106  # rad: by how much the filter's heading has to turn to agree with the navigator's
NAV_HEADING_VAR = 107  # rad^2 of it as an observation, 0 when there is none
BODY_VELOCITY = 108  # 3: last velocity that a sensor in the vehicle measured, m/s, n
FORCE_BIAS = 111  # 3: accelerometer bias in b, from the navigator's level while GNSS aids it, m/s^2
IRON = 114  # 3: hard iron of the vehicle in b, unit of the field
IRON_COV = 117  # (3, 3) of it
IRON_USED = 126  # 3: what of it is taken out of the field
IRON_FIELD = 129  # 3: field in n at the last window that was compared ...
IRON_AXES = 132  # 9: ... the columns of C_nb ...
IRON_TIME = 141  # ... and AGE there
IRON_MISFIT = 142  # smoothed squared residual, relative
NEW_AGE = 143  # s since the candidate last failed to describe the field
OFFSET_TIME = 144  # AGE when the compass was last compared with the navigator
# --- constants -----------------------------------------------------------------------------------------------------
PERIOD = 145  # s between feedbacks
GRAVITY = 146  # m/s^2
POINT = 147  # 1: IMU values are instantaneous, 0: means over the interval that ends at the stamp
GAP_DT = 148  # s: a longer interval counts as a gap
GAP_RATE_SD = 149  # rad/s: unknown rate in a gap
WANDER_PSD = 150  # rad^2/s: walk of the attitude
BIAS_PSD = 151  # (rad/s)^2/s
MATRIX_PSD = 152  # 1/s
SWAY_PSD = 153  # (m/s^2)^2/Hz: noise of the specific force
MOTION_FLOOR = 154  # (m/s)^2 s: density of the vehicle's own sway at the least
MOTION_TAU = 155  # s: ... and half of it per SWAY_VAR
MOTION_RISE = 156  # s: smoothing of SWAY_VAR upwards
MOTION_FALL = 157  # s: ... and downwards
STILL_PSD = 158  # (m/s)^2 s: density of the sway at rest
STILL_RATE = 159  # rad/s
STILL_FORCE = 160  # m/s^2
STILL_NORM = 161  # m/s^2
LEVEL_AFTER = 162  # s at rest before STILL_PSD holds
LEARN_AFTER = 163  # s at rest before the mean rate is the gyro bias
LEARN_PSD = 164  # (rad/s)^2/Hz: noise of the rate at rest
BIAS_LIMIT = 165  # rad/s
REJECT_FROM = 166  # m/s^2
REJECT_TO = 167  # m/s^2
TIMING_SD = 168  # s: unknown delay of the sensor, for the covariance only
DECLINATION = 169  # rad, east positive
HEADING_PSD = 170  # rad^2 s: density of a magnetic heading's error
ANOMALY_GAIN = 171  # by how much an anomaly of 1 multiplies it
ANOMALY_TAU = 172  # s
FIELD_TAU = 173  # s: memory of the learned field
NEW_TAU = 174  # s: smoothing of the candidate
NEW_LIMIT = 175  # anomaly at which reference and candidate differ, relative square
NEW_AFTER = 176  # s of support that a candidate needs at most
NEW_HEADING_VAR = 177  # rad^2 after the reference was replaced
SWAY_TILT = 178  # rad per m/s: tilt by acceleration that lasts, for the covariance only
TURN_PSD = 179  # s: walk of the attitude per squared rate, from errors of the gyroscope that turn up in motion only
PLACE_VAR = 180  # rad^2: error of a magnetic heading that rest at one place does not average away
OWN = 181
"""Where a filter's own quantities begin."""
