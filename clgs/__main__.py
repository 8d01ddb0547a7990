"""``python -m clgs`` is the command ``clgs``."""

import sys

from clgs.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
