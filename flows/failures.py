"""What went wrong and stops nothing else: told, and kept where `solmap status` finds it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import SQLAlchemyError

from solmap.config.errors import ConfigError
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.products.catalogue.catalogue import Outcome
from solmap.products.catalogue.workspace import Workspace
from solmap.products.disk import is_full
from solmap.products.errors import ProductError, StoreFullError

log = logging.getLogger(__name__)


@contextmanager
def isolated(
    subject: str, workspace: Workspace, failures: list[str], told: str = "{}"
) -> Iterator[None]:
    """Go on after the block whatever fails in it, and keep the cause; but a full disk stops all.

    Args:
        subject: What is worked on, by its name in the catalogue's outcomes.
        workspace: Where outcomes are kept.
        failures: Gains a line.
        told: The line, with `{}` for the cause.

    Raises:
        StoreFullError: the disk is full; whatever else is tried would find it full too.
    """
    try:
        yield
    except StoreFullError:
        raise
    except Exception as error:
        if is_full(workspace.store.root, error):
            raise StoreFullError(
                f"the disk is full while working on {subject}; free some space and run again: "
                "what was made before is kept"
            ) from error
        log.warning("%s", told.format(cause_of(error)), exc_info=error)
        failures.append(told.format(cause_of(error)))
        keep(Outcome.now(subject, (cause_of(error),), is_failure=True), workspace)


def keep(outcome: Outcome, workspace: Workspace) -> None:
    """Keep how something ended; that it cannot be kept stops nothing."""
    try:
        workspace.catalogue.publish(outcomes=[outcome])
    except SQLAlchemyError as error:
        log.warning("how %s ended could not be noted: %s", outcome.subject, error)


def mended(subject: str, workspace: Workspace) -> None:
    """Say of what failed at an earlier time that it does no longer."""
    failed = {one.subject for one in workspace.catalogue.outcomes() if one.is_failure}
    if subject in failed:
        keep(Outcome.now(subject, ()), workspace)


def cause_of(error: Exception) -> str:
    """Our own errors speak for themselves; others are named. The traceback is on the run page."""
    if isinstance(error, PhotogrammetryError | ProductError | ConfigError):
        return str(error)
    return f"{type(error).__name__}: {error}"
