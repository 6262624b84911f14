"""The commands that need no rig, for ``python -m optimize.cli``."""

from optimize.cli import main
from optimize.ui.process import run_process

if __name__ == "__main__":
    run_process(lambda: main)
