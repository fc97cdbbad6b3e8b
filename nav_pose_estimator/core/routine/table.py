"""Layout of the input and output arrays of routine flight.

``settings`` is a float64 vector. ``events`` (K, EVENT_COLUMNS) has a row for each observation, in the order in which
they are applied; ``results`` (K, RESULT_COLUMNS) receives the results of those that were applied.
"""

# --- settings ------------------------------------------------------------------------------------------------------
FIX_USED = 0  # s: time of the last fix that corrected the filter; updated by the kernels
HEIGHT_USED = 1  # s: time of the last fix that corrected the height; updated
LOST_AFTER = 2  # s without a used fix after which GNSS counts as lost
RETURN_AFTER = 3  # s without a used fix after which the guard of the return decides
SIGMAS = 4  # largest normalised innovation of an expected fix, on each axis
SOFT, HARD = 5, 8  # 3, 3: bounds of the NIS for 1, 2, 3 rows
LEVER = 11  # 3: m, lever arm from the IMU to the antenna in b
DOUBTFUL = 14  # Mahalanobis distance of a horizontal position above which the filter is doubted
HEIGHT_STEP, HEIGHT_PAUSE = 15, 16  # m, s: a larger step between two fixes, closer than the pause, is a height jump
LAST_HEIGHT_T, LAST_HEIGHT = 17, 18  # s, m: time of the last fix, and its height less the filter's; updated
BARO_APART = 19  # m: a barometer further from the filter's height is in another unit
VAGUE_VAR = 20  # m^2: largest variance of the filter's height as a reference of the barometer
HEADING_SD = 21  # rad: largest deviation of the filter's heading as a reference of the magnetometer
DECLINATION = 22  # rad
LEAST_HEIGHT_SD = 23  # m: floor of the height's deviation while fixes correct it
HEIGHT_MEAN_T, HEIGHT_MEAN = 24, 25  # s, m: running mean of the height of fixes above the filter; updated
SETTINGS_SIZE = 26

# --- events --------------------------------------------------------------------------------------------------------
EVENT_T, EVENT_KIND = 0, 1  # s, and one of the kinds below
EVENT_BEHIND = 2  # number of IMU rows that had arrived before it
EVENT_ROWS = 3  # number of rows of an observation that corrects the filter
EVENT_VALUE = 4  # 3: latitude, longitude [rad], height [m]; velocity ENU [m/s]; height [m]; field in b
EVENT_NOISE = 7  # 9: R (3, 3), row-major
EVENT_LEAST = EVENT_NOISE + 9  # m: floor of the height's deviation after a position that is applied again
EVENT_COLUMNS = EVENT_LEAST + 1

UNUSUAL, VELOCITY, POSITION, HEIGHT, HEADING, SAME_VELOCITY, SAME_POSITION, NO_GNSS, NOTHING = range(9)
"""Kinds of events. ``UNUSUAL`` ends the routine. The last four are for observations that are applied again in a replay
of the past: behind their gate, as GNSS that was left out, or without effect."""

# --- results -------------------------------------------------------------------------------------------------------
RESULT_AHEAD = 0  # index of the IMU row before which it was applied
RESULT_NIS = 1
RESULT_Z = 2  # 3: innovation of a position; residual of a velocity after the update
RESULT_SD = 5  # 2: m, deviations of the filter's horizontal position before a fix
RESULT_LEAST = 7  # m: floor of the height's deviation after a fix
RESULT_INNOVATION = 5  # 3: m/s, innovation of a velocity
RESULT_HEIGHT, RESULT_VARIANCE = 1, 2  # m, m^2: height of the filter that a barometric height was compared with
RESULT_ERROR, RESULT_QUAT = 1, 2  # rad, (4,): error of a magnetic heading, and the attitude it was compared with
RESULT_BEFORE, RESULT_AFTER = 8, 11  # 3, 3: latitude, longitude, height of the filter before and after it
RESULT_COLUMNS = 14
