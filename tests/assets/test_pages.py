"""Pages that are read on a phone: pictures can be enlarged, tables scroll, and nothing comes from elsewhere."""

from gelgap.assets.pages import html_page


def test_pictures_of_a_page_can_be_enlarged_without_a_script() -> None:
    figures = [("forces", b"AAAA"), ("features", b"BBBB")]
    page = html_page("results.html", title="Runs", tables=[], figures=figures)
    assert '<meta name="viewport" content="width=device-width' in page
    assert page.count('<label class="picture"><input type="checkbox" aria-label="enlarge: ') == 2
    assert page.count('src="data:image/png;base64,') == 2
    assert ".picture input:checked + span { position: fixed" in page
    assert "<script" not in page
    assert "http" not in page
