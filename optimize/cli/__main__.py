"""The commands that need no rig, for ``python -m optimize.cli``."""

from optimize.cli import main

if __name__ == "__main__":
    main()
