"""The keys of `--set` for a contact: of the gel, and of the body that is pressed into it."""

from collections import defaultdict

from gelgap.cli.keys import Meanings


def gel_keys() -> Meanings:
    """Return the keys of a gel."""
    from gelgap.sim.scene import Elastomer

    return {name: field.description or "" for name, field in Elastomer.model_fields.items()}


def body_keys() -> Meanings:
    """Return the keys of all bodies, each with the bodies that have it."""
    from gelgap.sim.shapes import BODIES, fields_of

    meanings: Meanings = {}
    owners = defaultdict(list)
    for body in BODIES:
        for key, meaning in fields_of(body).items():
            meanings.setdefault(key, meaning)
            owners[key].append(body.shape)
    return {key: f"{', '.join(owners[key])}: {meaning}" for key, meaning in meanings.items()}
