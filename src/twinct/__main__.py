"""Entry point of ``python -m twinct``."""

from twinct.cli import main

if __name__ == "__main__":
    main()
