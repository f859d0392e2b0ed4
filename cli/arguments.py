"""What the commands' arguments share: how --help shows them, and a sensor by preset or file."""

from typing import TYPE_CHECKING, Annotated, Any

import tyro

from gelgap.cli.rules import Preset

if TYPE_CHECKING:
    from gelgap.adapt import Profile
    from gelgap.render import Illumination, Sensor
    from gelgap.sim import Elastomer

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")]
"""A switch that is off unless it is given."""


SensorName = Annotated[str, Preset("sensors")]
"""A sensor by its preset's name or its TOML file."""


def optional(metavar: str, default: str = "", aliases: tuple[str, ...] = (), help: str | None = None) -> Any:
    """Return the annotation of an argument that may be left out, with what happens then as --help shows it."""
    hint = f"(default: {default})" if default else ""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=hint, aliases=aliases, help=help)


def load_sensor(name: str) -> "Sensor":
    """Return the sensor of a TOML file or of a preset's name."""
    from gelgap.render import Sensor

    return Sensor.load(name) if name.endswith(".toml") else Sensor.preset(name)


def load_elastomer(name: str) -> "Elastomer":
    """Return the elastomer of a TOML file or of a preset's name."""
    from gelgap.sim import Elastomer

    return Elastomer.load(name) if name.endswith(".toml") else Elastomer.preset(name)


def load_illumination(name: str) -> "Illumination":
    """Return the illumination of a TOML file or of a preset's name."""
    from gelgap.render import Illumination

    return Illumination.load(name) if name.endswith(".toml") else Illumination.preset(name)


def load_profile(name: str) -> "Profile":
    """Return the training profile of a TOML file or of a preset's name."""
    from gelgap.adapt import Profile

    return Profile.load(name) if name.endswith(".toml") else Profile.preset(name)
