"""Meshes of the gel: plane cells around the contact, prisms of tetrahedra on them, and the order of their vertices."""
