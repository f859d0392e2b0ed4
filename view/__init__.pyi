from .meshes import save_mesh as save_mesh
from .page import open_page as open_page
