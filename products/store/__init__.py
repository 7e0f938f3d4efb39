"""The store: products are made once under the digest of their recipe, and read by reference.

Enters: a `Recipe` and a function that writes a file. Leaves: a `ProductRef`, and the path or
address of the file. Beside it: storage backends (a folder, an object store), locks between
processes, which errors are transient, provenance, and the log of a process.
Knows neither what is inside a file nor what is published: imports no other subpackage of
`products`.
"""
