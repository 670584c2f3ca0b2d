"""Virtual rigs: a nominal model, another model that is measured, and the measuring; one `Design` says what they look like."""
