"""Force, place, angles and area from the pins of a round fingertip."""
