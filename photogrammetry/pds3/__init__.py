"""PDS3 labels, pixels and vector files: bytes in, records out."""
