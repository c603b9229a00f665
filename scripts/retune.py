"""`navgym retune` from a clone: see --help."""

from __future__ import annotations

import sys

from navgym.command import main

if __name__ == "__main__":
    sys.exit(main(["retune", *sys.argv[1:]]))
