from .meshes import save_mesh as save_mesh
