"""Inverse finite elements of a flat pad: from surface displacement to nodal force."""
