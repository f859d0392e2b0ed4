"""`gelgap presets`: the presets that ship with gelgap."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from gelgap.assets import PRESET_KINDS, list_presets, load_preset
from gelgap.cli import options as opt


@dataclass(frozen=True)
class Presets(opt.Command):
    """List the presets of one kind, or of every kind.

    For example:
      gelgap presets elastomers
    """

    kind: Annotated[tyro.conf.Positional[str | None], opt.optional("[KIND]", "all"), list_presets] = None
    """One of elastomers, paths, illuminations, sensors, datasets and profiles."""

    def run(self, started: float) -> None:
        """Print one line per preset: its name and its description."""
        for kind in [self.kind] if self.kind else PRESET_KINDS:
            print(f"{kind}:")
            for name in list_presets(kind):
                print(f"  {name:<16} {load_preset(kind, name).get('description', '')}")
