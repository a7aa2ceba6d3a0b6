"""``python -m fmp_drake``: the command line."""

from fmp_drake.apps.main import main

if __name__ == "__main__":
    main()
