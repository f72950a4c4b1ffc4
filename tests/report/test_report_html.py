import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest

from hsvaos.detect.detections import Person
from hsvaos.report.html import report_html

_VOID = {"meta", "img", "input", "br", "hr", "link"}


class _Page(HTMLParser):
    """Collects tags and checks that each one that opens also closes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.wrong: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag) -> None:
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)

    def handle_data(self, data) -> None:
        self.text += data if not self.open or self.open[-1] not in ("script", "style") else ""

    def keys(self) -> list[str]:
        return [a["data-key"] for t, a in self.tags if t == "figure"]


def _embedded(text: str, key: str) -> np.ndarray:
    found = re.search(rf'data-key="{key}".*?base64,([^"]+)"', text)
    content = np.frombuffer(base64.b64decode(found.group(1)), np.uint8)
    return cv2.imdecode(content, cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"ortho": True},
        {"channels": 1, "rarity": False, "mask": "none", "stats": {}},
        {"persons": False, "origin": None},
        {"ortho": True, "origin": None, "mask": "rarity"},
    ],
)
def test_page_is_well_formed_and_needs_no_network(result_of, options) -> None:
    text = report_html(result_of(**options))
    page = _Page(text)
    assert page.wrong == []
    assert page.open == []
    for tag, attributes in page.tags:
        assert tag not in ("link", "iframe", "base")
        for name in ("src", "href"):
            target = attributes.get(name) or "#"
            assert target.startswith(("data:", "#", "geo:")), target
    assert not re.search(r"https?://|@import|url\(", text)
    assert "$" not in re.sub(r"<script>.*</script>", "", text, flags=re.S)
    ids = [a["id"] for _, a in page.tags if "id" in a]
    assert len(ids) == len(set(ids))


def test_pictures_follow_the_chain(result_of) -> None:
    page = _Page(report_html(result_of()))
    assert page.keys() == [
        "photo",
        "mask",
        "photo-rarity",
        "plain",
        "hue",
        "rarity",
        "ground",
        "rarity-map",
        "fragment-map",
        "footprint",
    ]
    bare = _Page(report_html(result_of(rarity=False, mask="none")))
    assert bare.keys() == ["photo", "mask", "plain", "footprint"]
    ground = _Page(report_html(result_of(ortho=True)))
    assert ground.keys()[:3] == ["raw", "photo", "mask"]


def test_what_was_not_seen_is_transparent_in_the_page(result_of) -> None:
    text = report_html(result_of())
    for key in ("hue", "footprint", "rarity-map", "fragment-map"):
        picture = _embedded(text, key)
        unseen = result_of().main.footprint == 0
        assert picture[unseen][:, 3].max() == 0
        assert picture[~unseen][:, 3].min() == 255
    hardly = result_of().main.extra["ground"][1] < 0.25
    assert hardly.sum() > unseen.sum()
    assert np.array_equal(_embedded(text, "ground")[..., 3] == 0, hardly)


def test_text_of_others_is_escaped(result_of) -> None:
    evil = "<script>alert('x')</script>"
    result = result_of(name=evil, notes=(evil,))
    page = _Page(report_html(result, [evil + "2"]))
    assert [tag for tag, _ in page.tags].count("script") == 1
    assert page.text.count(evil) == 4  # title, headline, two notes
    assert "# <b>" in page.text  # the settings, as text and not as a tag
    assert "# <b>" not in report_html(result)


def test_notes_come_once_and_before_the_pictures(result_of) -> None:
    result = result_of(notes=("Hue says nothing here.", "Two photos were skipped."))
    flight = result.flight.replace(notes=("Two photos were skipped.", "Height assumed."))
    text = report_html(replace(result, flight=flight))
    assert text.count("Two photos were skipped.") == 1
    assert text.index("Height assumed.") < text.index("data:image")
    assert "Please note" not in report_html(result_of())


def test_finds_have_a_position_to_copy(result_of) -> None:
    page = _Page(report_html(result_of()))
    copied = [a["data-copy"] for _, a in page.tags if "data-copy" in a]
    assert copied == ["47.5000100, 13.2499900"]
    assert "± 0.4 m" in page.text
    local = _Page(report_html(result_of(origin=None)))
    assert [a["data-copy"] for _, a in local.tags if "data-copy" in a] == ["N 1.5  E -0.5  D 0.0 m"]


def test_many_finds_do_not_swell_the_page(result_of) -> None:
    persons = tuple(Person(0.01 * i, 0.0, 0.0, None, None, 1.0, 5.0, 1) for i in range(300))
    text = report_html(replace(result_of(), persons=persons))
    assert text.count('class="rank"') == 60
    assert "240 weaker finds are in detections.json" in text
    assert "300 places to look at" in text


def test_no_find_is_no_promise(result_of) -> None:
    page = _Page(report_html(result_of(persons=False)))
    assert "Nothing stood out." in page.text
    assert "does not prove that nobody is there" in page.text
    blind = report_html(replace(result_of(persons=False), detected=False))
    assert "Finds were not looked for" in blind
    assert "Nothing stood out" not in blind


def test_find_outside_the_view_or_without_spread_is_listed_without_picture(result_of) -> None:
    far = Person(900.0, 900.0, 0.0, None, None, float("nan"), 0.5, 1)
    text = report_html(replace(result_of(), persons=(far,)))
    assert "not known" in text
    assert 'alt="Find 1' not in text
    assert 'alt="Find 1: ' in report_html(result_of())


def test_hue_that_says_nothing_is_told(result_of) -> None:
    stats = {"hue_informative": False, "hue_mean_deg": float("nan"), "hue_sigma_deg": 90.0}
    text = report_html(result_of(stats=stats))
    assert "The hues say nothing here" in text
    assert "the mask keeps everything" in text
    assert "nothing was taken out" in text
    assert "nan" not in _Page(text).text.lower()
