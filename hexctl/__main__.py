"""`python -m hexctl` is `hexctl`."""

from hexctl.cli.main import main

if __name__ == "__main__":
    main()
