"""
Your own domain gap
===================

Two domains that differ in modulus, friction and one LED's drive, and nothing else.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

from gelgap.data import open_domain
from gelgap.domains import generate_recipes, make_recipes
from gelgap.sim import ContactPath


def main(
    out_dir: Path | str = "data", path: str | ContactPath = "smoke", quality: str = "standard", **settings
) -> None:
    (source,) = make_recipes(["wmb0i0"], path, inpainted=(), quality=quality, **settings)
    brighter = source.illumination.leds[0].model_copy(
        update={"drive": 1.5 * source.illumination.leds[0].drive}
    )
    target = source.model_copy(
        update={
            "name": "harder-slippery-redder",
            "elastomer": source.elastomer.model_copy(update={"young_modulus_mpa": 0.9, "friction": 0.2}),
            "illumination": source.illumination.model_copy(
                update={"leds": (brighter, *source.illumination.leds[1:])}
            ),
        }
    )
    generate_recipes([source, target], out_dir, scheduler="synchronous")
    figure = plt.figure(figsize=(8, 3.2), layout="constrained")
    panels = figure.subplots(1, 2)
    for panel, recipe in zip(panels, (source, target), strict=True):
        domain = open_domain(Path(out_dir) / recipe.name)
        panel.imshow(domain.picture(len(domain) - 1))
        panel.set(title=recipe.name, xticks=[], yticks=[])
        print(f"{recipe.name}: {len(domain)} frames, Fz down to {domain.force_n[:, 2].min():.2f} N")
    figure.savefig(Path(out_dir) / "own_gap.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
    plt.show()
