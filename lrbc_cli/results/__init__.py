"""Records (pydantic models) of all files in the output folder, with one reader and one writer (``store``) for all of them.

Records are frozen. Files carry a version, and a file of another version is refused. A key that a record does not know, from a later
release of the same version, is kept and ignored. ``lrbc schema --results`` prints the JSON Schema of these definitions.
"""
