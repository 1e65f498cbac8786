"""``python -m shuttle_marl.exact``: the command in :mod:`shuttle_marl.commands.exact`."""

import sys

from shuttle_marl.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["exact", *sys.argv[1:]]))
