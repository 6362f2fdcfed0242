"""How much force a pad loses under a held strain."""
