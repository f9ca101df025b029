"""`python -m flexfmu`: the command line."""

from flexfmu.cosim.cli.main import main

if __name__ == "__main__":
    main()
