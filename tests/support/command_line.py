"""Commands called in the process of the test, put together once: that takes longer than most."""

from functools import cache
from typing import Any
from unittest.mock import patch

import typer.testing
from typer.main import get_command

_command = cache(get_command)


class CliRunner(typer.testing.CliRunner):
    """Typer's, with the commands of an app kept from call to call."""

    def invoke(self, *args: Any, **kwargs: Any) -> Any:
        with patch("typer.testing._get_command", _command):
            return super().invoke(*args, **kwargs)
