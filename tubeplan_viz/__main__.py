"""The command line as ``python -m tubeplan_viz``, where the installed command is not on the PATH."""

from tubeplan_viz.cli import main

if __name__ == "__main__":
    main()
