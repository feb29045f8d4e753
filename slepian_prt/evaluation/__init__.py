"""How good it is and what it costs: references, errors, comparisons, reports."""
