"""Charts as data, and their back ends: SVG for the page, PNG for files."""
