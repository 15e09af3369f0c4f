"""`python -m hexctl` is `hexctl`."""

from hexctl.cli.entry import main

if __name__ == "__main__":
    main()
