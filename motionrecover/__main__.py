"""`python -m motionrecover` is the command `motionrecover`."""

import sys

from motionrecover.cli import main

sys.exit(main())
