"""The page in a browser, and the server that brings a sensor's line to it."""
