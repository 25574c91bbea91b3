"""``python -m splitknit``: the command line."""

import sys

from splitknit.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
