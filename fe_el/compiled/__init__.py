"""How loops are compiled: one version per dimension, vector rows, arrays without reference counts."""
