"""Drafts a campaign file from the files of a folder (``lrbc init --from``): ``recognise`` them, find their ``roles``, write a ``draft``."""
