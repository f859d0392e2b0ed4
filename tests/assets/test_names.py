"""Names in sentences."""

from gelgap.assets.names import listed


def test_many_names_are_counted_instead_of_listed() -> None:
    names = [f"d{number}" for number in range(13)]
    assert listed(names[:12]) == ", ".join(names[:12])
    assert listed(names) == "d0, d1, … d12 (13)"
    assert listed([]) == ""
