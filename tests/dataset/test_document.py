"""One description says the same on a card and on a page."""

from lxml import etree

from dexnudge.dataset.document import Document, Section, Table

TABLE = Table("behaviour", ("name", "kept", "share"), (("a|b", 3, 0.25), ("<i>", 12, "-")))
DOCUMENT = Document(
    "Title",
    "In short.",
    (
        Section("Counts", (TABLE, "A & B.")),
        Section("Files", ("- one\n- two", "```python\nx < 1\n```")),
    ),
)


def test_the_card_is_markdown_whose_numbers_stand_right():
    text = DOCUMENT.markdown()
    assert text.startswith("# Title\n\nIn short.\n\n## Counts\n\nbehaviour:\n\n")
    assert "| name | kept | share |\n| --- | ---: | ---: |\n| a\\|b | 3 | 0.25 |\n| <i> | 12 | - |\n" in text
    assert "## Files\n\n- one\n- two\n\n```python\nx < 1\n```\n" in text


def test_the_page_is_well_formed_and_interprets_no_text():
    body = etree.fromstring(f"<body>{DOCUMENT.html()}</body>")
    assert [cell.text for cell in body.iter("th")] == ["behaviour", "kept", "share"]
    assert [cell.text for cell in body.iter("td")] == ["a|b", "3", "0.25", "<i>", "12", "-"]
    assert [item.text for item in body.iter("li")] == ["one", "two"]
    assert body.find("pre").text == "x < 1\n"
    assert body.find("p").text == "A & B."
