"""The errors of the product store and catalogue, and how any error is put into one line."""

LONGEST_LINE = 400


class ProductError(Exception):
    """A product cannot be kept, found or read."""


class ProductNotFoundError(ProductError):
    """No such product, layer or image."""


class OutsideCoverageError(ProductError):
    """The product exists but holds nothing at the place asked for."""


class StoreFullError(ProductError):
    """The disk of the store is full; nothing already made is lost."""


class StoreBusyError(ProductError):
    """Others work on the store, and what was asked for is done alone."""


class StoreReadOnlyError(ProductError):
    """The store may not be changed: by this user, or because its disk may only be read."""


class StoreAwayError(ProductError):
    """The store or its catalogue does not answer now; trying again may help."""


def cause_of(error: BaseException, *, is_named: bool = False) -> str:
    """What went wrong, in one bounded line: our own errors speak for themselves, others are named.

    Args:
        error: Of any kind.
        is_named: Name our own errors too.
    """
    try:
        said = str(error)
    except Exception:  # noqa: BLE001 - an error of another library that cannot be printed
        said = ""
    name = type(error).__name__
    is_ours = type(error).__module__.startswith("solmap.")
    if said and is_ours and not is_named:
        return one_line(said)
    return one_line(f"{name}: {said}" if said else name)


def one_line(text: str) -> str:
    """A text as one bounded line of printable characters; others are escaped."""
    plain = printable(" ".join(text[: 4 * LONGEST_LINE].split()))
    return plain if len(plain) <= LONGEST_LINE else f"{plain[: LONGEST_LINE - 4]} ..."


def printable(text: object) -> str:
    """A text on one line that steers no terminal.

    Control characters, line ends, changes of the writing direction and lone surrogates are shown as
    escapes, as Python writes them.
    """
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in str(text)
    )
