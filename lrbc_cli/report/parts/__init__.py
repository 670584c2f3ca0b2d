"""Charts, tables and sections of the page, each built from records."""
