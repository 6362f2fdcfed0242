"""Wrench, depth, area, kind and hardness of a contact from a texture's flow."""
