"""``python -m nav_pose_estimator COMMAND``."""

import sys

from nav_pose_estimator.offline.command_line import main

if __name__ == "__main__":
    sys.exit(main())
