"""Flows over everything that is in a store: for schedules, which know no mission by name."""

from __future__ import annotations
