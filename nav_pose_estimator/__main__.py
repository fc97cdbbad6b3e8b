"""``python -m nav_pose_estimator COMMAND``: the commands on recordings, and the nodes."""

import sys

from nav_pose_estimator.offline.command_line import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
