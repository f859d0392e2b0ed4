"""Import every module of the installed gelgap and load every preset; run outside the source folder."""

import importlib
import pkgutil
from importlib.resources import files

import gelgap
from gelgap.assets import PRESET_KINDS, list_presets, load_preset

modules = [module.name for module in pkgutil.walk_packages(gelgap.__path__, "gelgap.")]
for name in modules:
    importlib.import_module(name)
presets = [(kind, name) for kind in PRESET_KINDS for name in list_presets(kind)]
for kind, name in presets:
    load_preset(kind, name)
assert presets, "the wheel holds no presets"
for room in pkgutil.iter_modules(gelgap.__path__, "gelgap."):
    assert files(room.name).joinpath("py.typed").is_file(), f"{room.name} has no py.typed"
print(f"imported {len(modules)} modules, loaded {len(presets)} presets from {list(gelgap.__path__)}")
