from .meshes import save_mesh as save_mesh
from .page import open_page as open_page
from .state import Configuration as Configuration
from .state import LiveModel as LiveModel
from .state import Shown as Shown
