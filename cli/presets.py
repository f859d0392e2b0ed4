"""`gelgap presets`: the presets that ship with gelgap."""

from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from gelgap.assets import PRESET_KINDS, list_presets, load_preset
from gelgap.cli import options as opt
from gelgap.cli.adapt import profile_keys
from gelgap.cli.contact_keys import body_keys, gel_keys
from gelgap.cli.keys import Meanings

KEYS = {"elastomers": gel_keys, "indenters": body_keys, "profiles": profile_keys}


@dataclass(frozen=True)
class Presets(opt.Command):
    """List the presets of one kind, or of every kind.

    Of one kind of gels, indenters or profiles, values are listed too, as --set takes them.

    For example:
      gelgap presets elastomers
      gelgap presets indenters
    """

    kind: Annotated[tyro.conf.Positional[str | None], opt.optional("[KIND]", "all"), list_presets] = None
    """One of elastomers, indenters, paths, illuminations, sensors, markers, datasets and profiles."""

    def run(self, started: float) -> None:
        """Print a line for each preset, its name and description, and for one kind a line with its values."""
        for kind in [self.kind] if self.kind else PRESET_KINDS:
            print(f"{kind}:")
            for name in list_presets(kind):
                values = load_preset(kind, name)
                print(f"  {name:<16} {values.get('description', '')}")
                if self.kind in KEYS:
                    shape = f"{values['shape']}: " if "shape" in values else ""
                    print(f"  {'':<16} {shape}{_as_set(values, KEYS[self.kind]())}")
        if self.kind == "indenters":
            from gelgap.sim.shapes import SHAPES

            print("shapes:")
            for name, body in SHAPES.items():
                print(f"  {name:<16} {_as_set(body().model_dump(), body_keys())}")


def _as_set(values: dict[str, Any], keys: Meanings) -> str:
    """Return values of these keys as --set takes them."""
    words = []
    for key in [key for key in keys if key in values]:
        value = values[key]
        several = isinstance(value, list | tuple)
        words.append(f"{key}={','.join(map(_text, value)) if several else _text(value)}")
    return " ".join(words)


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
