"""`navgym train` from a clone: see --help."""

from __future__ import annotations

import sys

from navgym.command import main

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
