"""`gelgap presets`: the presets that ship with gelgap."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import tyro

from gelgap.assets import PRESET_KINDS
from gelgap.cli.arguments import optional
from gelgap.cli.rules import OneOf


@dataclass(frozen=True)
class Presets:
    """List the presets of one kind, or of every kind.

    For example:
      gelgap presets elastomers
    """

    when_stopped: ClassVar[str] = "nothing was changed; run the same command again"

    kind: Annotated[
        tyro.conf.Positional[str | None], optional("[KIND]", "all"), OneOf(lambda: PRESET_KINDS)
    ] = None
    """One of elastomers, paths, illuminations, sensors, datasets and profiles."""

    def run(self, started: float) -> None:
        """Print one line per preset: its name and its description."""
        from gelgap.assets import list_presets, load_preset

        for kind in [self.kind] if self.kind else PRESET_KINDS:
            names = list_presets(kind)
            print(f"{kind}:")
            for name in names:
                print(f"  {name:<16} {load_preset(kind, name).get('description', '')}")
