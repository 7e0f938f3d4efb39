"""The store: products are made once under the digest of their recipe, and read by reference.

Enters: a `Recipe` and a function that writes a file. Leaves: a `ProductRef`, and the path or
address of the file. Also: storage backends (a folder, an object store), locks between processes,
transient errors, provenance, and the log of a process. Independent of file contents and of
publication: imports no other subpackage of `products`.
"""
