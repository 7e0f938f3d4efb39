"""The errors of the product store and catalogue, and one-line texts of any error."""

LONGEST_LINE = 400


class ProductError(Exception):
    """A product cannot be stored, found or read."""


class ProductNotFoundError(ProductError):
    """No such product, layer or image."""


class BrokenProductError(ProductError):
    """The file of a product is not of its kind; the text ends with the remedy."""

    def __str__(self) -> str:
        return f"{super().__str__()}; `solmap check --repair` and a new run replace it"


class OutsideCoverageError(ProductError):
    """The product exists but has no data at the requested position."""


class StoreFullError(ProductError):
    """The disk of the store is full; finished products are kept."""


class StoreBusyError(ProductError):
    """Others are using the store, and the action needs it exclusively."""


class StoreReadOnlyError(ProductError):
    """The store may not be changed: by this user, or because its disk is read-only."""


class StoreAwayError(ProductError):
    """The store or its catalogue does not respond now; trying again may help."""


def cause_of(error: BaseException, *, is_named: bool = False) -> str:
    """The cause of an error, in one bounded line: with the name of errors other than our own.

    Args:
        error: Of any kind.
        is_named: Name our own errors too.
    """
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 - an error of another library that cannot be printed
        text = ""
    name = type(error).__name__
    is_ours = type(error).__module__.startswith("solmap.")
    if text and is_ours and not is_named:
        return one_line(text)
    return one_line(f"{name}: {text}" if text else name)


def one_line(text: str) -> str:
    """A text as one bounded line of printable characters; others are escaped."""
    plain = printable(" ".join(text[: 4 * LONGEST_LINE].split()))
    return plain if len(plain) <= LONGEST_LINE else f"{plain[: LONGEST_LINE - 4]} ..."


def printable(text: object) -> str:
    """A text on one line without control sequences for terminals.

    Control characters, line ends, changes of the writing direction and lone surrogates are shown as
    escapes, as Python writes them.
    """
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in str(text)
    )
