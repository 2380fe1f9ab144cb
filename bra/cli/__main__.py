"""`python -m bra.cli` is the command `bra`."""

from bra.cli import main

if __name__ == "__main__":
    main()
