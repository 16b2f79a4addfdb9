"""Contacts: laws, lists of pairs and of walls, forces, sub-steps."""
