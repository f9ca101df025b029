"""The command line in this process."""

from __future__ import annotations

from typer.testing import CliRunner, Result

from flexfmu.cosim.cli.main import app


def flexfmu(*arguments: object) -> Result:
    """Run a command."""
    return CliRunner().invoke(app, [*map(str, arguments)])
