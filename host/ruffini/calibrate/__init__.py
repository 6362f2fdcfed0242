"""From recordings of known touches to the tables that the board runs."""
