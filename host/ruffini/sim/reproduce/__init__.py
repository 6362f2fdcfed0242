"""The papers' rigs as scenarios: reproduce.toml of a board, and the recordings that it makes."""
