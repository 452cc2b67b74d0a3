"""``python -m calstudy`` is the command ``calstudy``."""

import sys

from calstudy.cli.main import program

if __name__ == "__main__":
    sys.exit(program())
