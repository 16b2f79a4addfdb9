"""Lagrangian particles: storage, location on unstructured cells, motion and contacts."""
