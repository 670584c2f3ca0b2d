"""Charts as data, their layout, and the back ends that draw them: SVG for the page, PNG, PDF and SVG files."""
