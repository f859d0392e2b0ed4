from .configuration import Configuration as Configuration
from .live import LiveModel as LiveModel
from .live import Shown as Shown
from .meshes import save_mesh as save_mesh
from .opening import open_page as open_page
