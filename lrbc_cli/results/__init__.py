"""Records of everything that is written under the output folder and read again: one definition, one reader, one writer.

Records are frozen and carry a version. A file of another version is refused. A key that a record does not know, from a later release of
the same version, is kept and ignored. ``lrbc schema --results`` prints the JSON Schema of these definitions.
"""
