"""Drafts a campaign file from the files of a folder: recognises them, finds their roles, and writes the text."""
