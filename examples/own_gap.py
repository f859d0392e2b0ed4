"""Your own domain gap: two domains that differ in modulus, friction and one LED's drive, and nothing else."""

import sys
from pathlib import Path

from gelgap.domains import generate_recipes, make_recipes
from gelgap.sim import ContactPath


def main(out_dir: Path, path: str | ContactPath = "smoke", quality: str = "standard", **settings) -> None:
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
    print(generate_recipes([source, target], out_dir, scheduler="synchronous"))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "data"))
