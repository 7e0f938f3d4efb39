"""The errors of the product store and catalogue."""


class ProductError(Exception):
    """A product cannot be kept, found or read."""


class ProductNotFoundError(ProductError):
    """No such product, layer or image."""


class OutsideCoverageError(ProductError):
    """The product exists but holds nothing at the place asked for."""


class StoreFullError(ProductError):
    """The disk of the store is full; nothing already made is lost."""


class StoreAwayError(ProductError):
    """The store or its catalogue does not answer now; trying again may help."""
