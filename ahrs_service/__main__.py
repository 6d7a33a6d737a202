"""The command line as `python -m ahrs_service`."""

import sys

from ahrs_service.app.cli import main

if __name__ == "__main__":
    sys.exit(main())
