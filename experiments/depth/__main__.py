"""`python -m experiments.depth`, from the repository's root."""

import sys

from .compare import main

if __name__ == "__main__":
    sys.exit(main())
