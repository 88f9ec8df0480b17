"""`python -m gscore` is the same as `gscore`."""

import sys

from .commands import main

if __name__ == "__main__":
    sys.exit(main())
