"""From the full-order model to a certified reduced model: ``build`` runs the steps, ``predict`` says what they will cost."""
