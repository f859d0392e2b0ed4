"""Names in sentences."""

from gelgap.assets.names import comma_list


def test_many_names_are_counted_instead_of_listed() -> None:
    names = [f"d{number}" for number in range(13)]
    assert comma_list(names[:12]) == ", ".join(names[:12])
    assert comma_list(names) == "d0, d1, … d12 (13)"
    assert comma_list([]) == ""
