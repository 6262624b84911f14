"""The whole program, for ``python -m hw.cli``."""

from hw.start import main

if __name__ == "__main__":
    main()
