"""`python -m solmap.flows.cli`."""

from __future__ import annotations

from solmap.flows.cli import app

app()
