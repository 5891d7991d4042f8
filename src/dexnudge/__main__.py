"""`python -m dexnudge`: the same as the `dexnudge` command."""

from dexnudge.cli.main import run

run()
