"""From the full-order model to a certified reduced model: ``build`` runs the steps, ``predict`` estimates their cost."""
