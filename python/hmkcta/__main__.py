"""`python -m hmkcta` is `hmkcta`."""

from .cli import main

if __name__ == "__main__":
    main(prog_name="hmkcta")
