"""Images as products, under the name that tasks know them by (see `products.images`)."""

from solmap.products.catalogue.images import (
    REMEMBERED,
    ImageFile,
    image_file,
    image_record,
    image_records,
    read_product_image,
)

__all__ = [
    "REMEMBERED",
    "ImageFile",
    "image_file",
    "image_record",
    "image_records",
    "read_product_image",
]
