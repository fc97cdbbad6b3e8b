"""The place of every number in the tables that routine flight is told, and answers, in.

``settings`` is a float64 vector, ``events`` (K, EVENT_COLUMNS) has a row for each observation in the order in which
they act, ``results`` (K, RESULT_COLUMNS) receives what came of those that did.
"""

# --- settings ------------------------------------------------------------------------------------------------------
FIX_USED = 0  # s: the last fix that corrected the filter; kept up to date
HEIGHT_USED = 1  # s: ... the height; kept up to date
LOST_AFTER = 2  # s without a used fix after which GNSS counts as lost
RETURN_AFTER = 3  # s without one after which a fix has to prove itself
SIGMAS = 4  # within which a fix is expected, on each axis
SOFT, HARD = 5, 8  # 3, 3: bounds of the normalised innovation squared for 1, 2, 3 rows
LEVER = 11  # 3: m, from the IMU to the antenna in b
DOUBTFUL = 14  # Mahalanobis distance of a horizontal position that casts doubt on the filter
HEIGHT_STEP, HEIGHT_PAUSE = 15, 16  # m, s: between two fixes in a row a larger step is none of the vehicle's
LAST_HEIGHT_T, LAST_HEIGHT = 17, 18  # s, m: of the last fix, less the filter's height; kept up to date
BARO_APART = 19  # m: a barometer farther from the filter's height is in another unit
VAGUE_VAR = 20  # m^2: variance of a height that is no reference
HEADING_SD = 21  # rad: a heading less certain is no reference
DECLINATION = 22  # rad
LEAST_HEIGHT_SD = 23  # m: of the filter's height while fixes correct it
HEIGHT_MEAN_T, HEIGHT_MEAN = 24, 25  # s, m: mean by which fixes lie above the filter; kept up to date
SETTINGS_SIZE = 26

# --- events --------------------------------------------------------------------------------------------------------
EVENT_T, EVENT_KIND = 0, 1  # s, and one of the kinds below
EVENT_BEHIND = 2  # how many IMU rows had arrived before it
EVENT_ROWS = 3  # of an observation that corrects the filter
EVENT_VALUE = 4  # 3: latitude, longitude [rad], height [m]; velocity ENU [m/s]; height [m]; field in b
EVENT_NOISE = 7  # 9: R (3, 3), row-major
EVENT_LEAST = EVENT_NOISE + 9  # m: least deviation of the height afterwards, of a position that acts again
EVENT_COLUMNS = EVENT_LEAST + 1

UNUSUAL, VELOCITY, POSITION, HEIGHT, HEADING, SAME_VELOCITY, SAME_POSITION, NO_GNSS, NOTHING = range(9)
"""Kinds. What is ``UNUSUAL`` ends the routine. The last ones act again, where the past is flown once more: behind their
gate, or as GNSS that was left out, or not at all."""

# --- results -------------------------------------------------------------------------------------------------------
RESULT_AHEAD = 0  # number of the IMU row ahead of which it acted
RESULT_NIS = 1
RESULT_Z = 2  # 3: innovation of a position, of a velocity what is left of it
RESULT_SD = 5  # 2: m, deviations of the filter's horizontal position ahead of a fix
RESULT_LEAST = 7  # m: least deviation of the height afterwards
RESULT_INNOVATION = 5  # 3: m/s, of a velocity
RESULT_HEIGHT, RESULT_VARIANCE = 1, 2  # of the filter where a height was compared: m, m^2
RESULT_ERROR, RESULT_QUAT = 1, 2  # rad, (4,): of a magnetic heading, and the attitude that it was compared with
RESULT_BEFORE, RESULT_AFTER = 8, 11  # 3, 3: latitude, longitude, height of the filter ahead of it and behind it
RESULT_COLUMNS = 14
