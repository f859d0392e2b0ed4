"""Ranges of labels as the command line writes them, `fz_n=-30:0`."""

from gelgap.assets.names import quoted


def label_ranges(texts: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Return ranges by label, of texts such as `fz_n=-30:0`; a ValueError says what is wrong with one."""
    from gelgap.data.frames.labels import Labels

    named = []
    for text in texts:
        try:
            name, bounds = text.split("=")
            low, high = map(float, bounds.split(":"))
        except ValueError:
            raise ValueError(f"{quoted(text)} must be a label and its two bounds, as fz_n=-30:0") from None
        named.append((name, (low, high)))
    labels = Labels(tuple(name for name, _ in named), tuple(bounds for _, bounds in named))
    return dict(zip(labels.names, labels.ranges, strict=True))
