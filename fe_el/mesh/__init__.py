"""Meshes: reading, boxes, partition, and their cells as plain arrays."""
