"""Methods of other people's code, named by `module:Class` or `file.py:Class`."""

import hashlib
import inspect
import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from gelgap.adapt.methods.base import Method


def load_method(place: str) -> tuple[str, type[Method]]:
    """Return a method's name for results, `module.Class`, and its class, from `module:Class` or `file.py:Class`.

    This runs the code of that module.

    Raises
    ------
    ValueError
        If there is no such module or class, the module fails, or the class is no `Method`.
    """
    module_name, _, class_name = place.rpartition(":")
    try:
        module = _from_file(module_name) if module_name.endswith(".py") else import_module(module_name)
    except Exception as error:
        raise ValueError(
            f"method {place!r}: {module_name} could not be imported ({type(error).__name__}: {error}); "
            "name a module or a .py file, and a class in it"
        ) from error
    method = getattr(module, class_name, None)
    if not (isinstance(method, type) and issubclass(method, Method)):
        methods = [name for name, thing in vars(module).items() if _is_own_method(thing, module)]
        raise ValueError(
            f"method {place!r}: {class_name or 'nothing'} is not a class of {module_name} that extends "
            f"gelgap.adapt.Method; it has {', '.join(methods) or 'none'}"
        )
    return f"{Path(module_name).stem if module_name.endswith('.py') else module_name}.{class_name}", method


def code_digest(method: type[Method]) -> str:
    """Return a hash of the file that defines a method: results of changed code are not taken for the same."""
    file = inspect.getsourcefile(method)
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else ""


def _from_file(name: str) -> ModuleType:
    path = Path(name).resolve()
    if not path.is_file():
        raise FileNotFoundError(f"{name} does not exist")
    # The class is found by its module's name when its source is asked for.
    known_as = f"gelgap_own_{hashlib.sha256(str(path).encode()).hexdigest()[:12]}"
    if known_as not in sys.modules:
        spec = spec_from_file_location(known_as, path)
        module = sys.modules[known_as] = module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[known_as]
            raise
    return sys.modules[known_as]


def _is_own_method(thing: object, module: ModuleType) -> bool:
    return isinstance(thing, type) and issubclass(thing, Method) and thing.__module__ == module.__name__
