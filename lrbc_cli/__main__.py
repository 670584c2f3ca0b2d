"""``python -m lrbc_cli`` is ``lrbc``."""

from lrbc_cli.cli.main import main

if __name__ == "__main__":
    main()
