"""Layout of the state vector of an attitude filter: the index of each quantity. Code uses these names, never numbers.

One float64 vector holds estimate, memory and tuning constants of a filter: a compiled step takes one array, an output
is one copy of its head, and a snapshot is one copy of the whole. Both filters share this layout; each appends its own
covariance from ``OWN`` on.
"""

# --- head: the quantities of an attitude solution ------------------------------------------------------------------
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
SWAY = 32  # 3: integral in n of specific force plus gravity, which only tilt or motion can make grow, m/s
SWAY_LOW = 35  # 2: low-passed horizontal sway, m/s
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
SUM_WALK = 56  # rad^2 per axis: accumulated random walk of the attitude
FIELD_COUNT = 57  # samples in SUM_FIELD
COLUMNS = 58  # 9: columns of C_nb at the last feedback
# --- rest and rejection --------------------------------------------------------------------------------------------
MEAN_RATE = 67  # 3: smoothed raw rate, rad/s
MEAN_FORCE = 70  # 3: smoothed raw force, m/s^2
STILL_TIME = 73  # s without motion
LOW_FORCE = 74  # 3: low-passed force in n, m/s^2
TRUST = 77  # p(a), 0 ... 1
MOTION = 78  # smoothed norm of the rate, rad/s
# --- acceleration from the navigator or a velocity sensor ----------------------------------------------------------
NAV_ACCEL = 79  # 3: m/s^2, n
NAV_HOLD = 82  # s for which it remains valid
NAV_SPEED = 83  # m/s, negative when unknown
# --- magnetic field ------------------------------------------------------------------------------------------------
FIELD_H = 84  # learned horizontal part, 0 before the first sample
FIELD_V = 85  # learned downward part
FIELD_SUPPORT = 86  # s of data that support them
FIELD_ANOMALY = 87  # smoothed squared deviation of the field from them, relative to FIELD_H squared
FIELD_TRUST = 88  # 0 disturbed ... 1 undisturbed
FIELD_TIME = 89  # AGE at the last field observation
NEW_H = 90  # candidate for FIELD_H, from the field of the last seconds
NEW_V = 91  # candidate for FIELD_V
NEW_ANOMALY = 92  # smoothed squared deviation of the field from the candidate
NEW_SUPPORT = 93  # s of data that support the candidate
FIELD_CHANGES = 94  # how often a candidate replaced the reference
# --- sensor status from the engine, magnetometer delay, heading reference, hard iron -------------------------------
EXTRA_PSD = 95  # rad^2/s: additional random walk of the attitude while the gyroscope is saturated or stuck
EXTRA_SWAY_PSD = 96  # (m/s^2)^2/Hz: additional noise of the force while the accelerometer is saturated
FROZEN = 97  # 1 while a sensor is stuck: rest cannot be detected, and the force is not used
SUM_SWEEP = 98  # 3: sum of w x m in n over the samples of SUM_FIELD, the change of the field per second of delay
MAG_DELAY = 101  # s: delay of the magnetometer relative to the gyroscope
MAG_DELAY_VAR = 102  # s^2: its variance
FIELD_TURN = 103  # rad turned since the heading was taken from the field: turning averages out its local error
COMPASS_OFFSET = 104  # rad: error of the magnetic heading relative to the navigator's, learned while that one is good
OFFSET_SUPPORT = 105  # s of data that support it
NAV_HEADING = 106  # rad: turn of the filter's heading that would make it agree with the navigator's
NAV_HEADING_VAR = 107  # rad^2: variance of it as an observation, 0 where there is none
BODY_VELOCITY = 108  # 3: last velocity from a sensor in the vehicle, m/s, n
FORCE_BIAS = 111  # 3: accelerometer bias in b, from the navigator while GNSS aids it, m/s^2
IRON = 114  # 3: estimated hard iron of the vehicle in b, unit of the field
IRON_COV = 117  # (3, 3): its covariance
IRON_USED = 126  # 3: hard iron that is subtracted from the field
IRON_FIELD = 129  # 3: field in n at the last window that was compared ...
IRON_AXES = 132  # 9: ... the columns of C_nb ...
IRON_TIME = 141  # ... and AGE there
IRON_MISFIT = 142  # smoothed NIS per degree of freedom of the differences
NEW_AGE = 143  # s since the candidate last failed to describe the field
OFFSET_TIME = 144  # AGE when the compass was last compared with the navigator
# --- constants -----------------------------------------------------------------------------------------------------
PERIOD = 145  # s between feedbacks
GRAVITY = 146  # m/s^2
POINT = 147  # 1: IMU values are instantaneous, 0: means over the interval that ends at the stamp
GAP_DT = 148  # s: a longer interval counts as a gap
GAP_RATE_SD = 149  # rad/s: unknown rate in a gap
WANDER_PSD = 150  # rad^2/s: random walk of the attitude
BIAS_PSD = 151  # (rad/s)^2/s
MATRIX_PSD = 152  # 1/s
SWAY_PSD = 153  # (m/s^2)^2/Hz: noise of the specific force
MOTION_FLOOR = 154  # (m/s)^2 s: smallest density of the vehicle's own sway
MOTION_TAU = 155  # s: correlation time of that sway; its density grows by 2 MOTION_TAU SWAY_VAR
MOTION_RISE = 156  # s: smoothing of SWAY_VAR while it rises
MOTION_FALL = 157  # s: smoothing of SWAY_VAR while it falls
STILL_PSD = 158  # (m/s)^2 s: density of the sway at rest
STILL_RATE = 159  # rad/s: largest standard deviation of the rate at rest
STILL_FORCE = 160  # m/s^2: largest standard deviation of the force at rest
STILL_NORM = 161  # m/s^2: largest difference of the mean force's norm from gravity at rest
LEVEL_AFTER = 162  # s at rest before STILL_PSD applies
LEARN_AFTER = 163  # s at rest before the mean rate observes the gyro bias
LEARN_PSD = 164  # (rad/s)^2/Hz: noise of the rate at rest
BIAS_LIMIT = 165  # rad/s: largest mean rate of an axis at rest
REJECT_FROM = 166  # m/s^2: difference of the force's norm from gravity at which p(a) begins to fall from 1
REJECT_TO = 167  # m/s^2: ... and at which it has reached its minimum
TIMING_SD = 168  # s: unknown delay of the sensor, for the covariance only
DECLINATION = 169  # rad, east positive
HEADING_PSD = 170  # rad^2 s: density of a magnetic heading's error
ANOMALY_GAIN = 171  # increase of HEADING_PSD by an anomaly of 1, as a multiple of it
ANOMALY_TAU = 172  # s: smoothing of the anomalies
FIELD_TAU = 173  # s: memory of the learned field
NEW_TAU = 174  # s: smoothing of the candidate
NEW_LIMIT = 175  # anomaly (relative square) above which reference and candidate differ
NEW_AFTER = 176  # s: largest support that a candidate needs
NEW_HEADING_VAR = 177  # rad^2: largest heading variance after the reference was replaced
SWAY_TILT = 178  # rad per m/s: tilt error by lasting acceleration, for the covariance only
TURN_PSD = 179  # s: random walk of the attitude per squared rate, from gyroscope errors that occur in motion only
PLACE_VAR = 180  # rad^2: variance of the magnetic heading's local error, which does not average out at one place
OWN = 181
"""First index of a filter's own quantities."""
