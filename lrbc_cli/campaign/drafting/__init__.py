"""A campaign file from the files that are there: what they are, which roles they play, and the text of the campaign."""
