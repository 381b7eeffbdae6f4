"""Pages that turn, in a browser without a screen: they open without a complaint, turn, step, play,
answer to the keyboard and to fingers, and fit a phone. Needs Chromium or Chrome on the machine."""

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from poseterior.inference.hypothesis import hypotheses
from poseterior.inference.results import Result
from poseterior.reports.interactive.film import film_page
from poseterior.reports.interactive.page import write_page
from poseterior.reports.interactive.person import person_page
from tests.reports.test_interactive import EVIL, film_tree, named

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
PHONE = {"width": 390, "height": 844}
Open = Callable[..., "Page"]


@pytest.fixture(scope="module")
def browser() -> Iterator["Browser"]:
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip("no Chromium or Chrome is on the PATH, in which pages could be tried")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as player:
        started = player.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture
def opened(browser: "Browser", tmp_path: Path) -> Iterator[Open]:
    """Opens a page of HTML; at the end nothing was said in the console, and nothing asked for."""
    complaints: list[str] = []
    shown: list[Page] = []

    def open_page(html: str, **options: object) -> "Page":
        write_page(html, tmp_path / "page.html")
        page = browser.new_page(**{"viewport": {"width": 1280, "height": 900}, **options})
        shown.append(page)
        page.on("console", lambda said: complaints.append(said.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("dialog", lambda dialog: complaints.append(dialog.message))
        page.on(
            "request",
            lambda asked: (
                complaints.append(asked.url)
                if not asked.url.startswith(("file:", "data:"))
                else None
            ),
        )
        page.goto((tmp_path / "page.html").as_uri())
        settle(page)
        return page

    yield open_page
    for page in shown:
        page.close()
    assert complaints == []


def settle(page: "Page") -> None:
    """Waits until what was asked for is drawn: two frames of the screen."""
    page.evaluate(
        "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    )


def drawing(page: "Page", canvas: str = "#scene") -> str:
    """What a canvas shows."""
    settle(page)
    return page.evaluate(f"document.querySelector('{canvas}').toDataURL()")


@pytest.fixture(scope="module")
def person(example_result: Result) -> str:
    image = np.full((640, 480, 3), 150, np.uint8)
    five = hypotheses(example_result, 5)
    return person_page(
        named(example_result, source=EVIL),
        five,
        image=image,
        truth=five[0].joints + 0.1,
        warnings=[EVIL],
    )


@pytest.fixture(scope="module")
def film() -> str:
    return film_page(film_tree([f"{EVIL}{index}/0" for index in range(8)]), EVIL)


def test_a_scene_turns_by_hand_by_key_and_by_button(opened: Open, person: str) -> None:
    page = opened(person)
    seen = [drawing(page)]

    def changed() -> None:
        seen.append(drawing(page))
        assert seen[-1] != seen[-2]

    box = page.locator("#scene").bounding_box()
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 80, middle[1] + 10, steps=4)
    page.mouse.up()
    changed()
    page.locator("#scene").focus()
    for key in ("ArrowLeft", "ArrowDown", "+", "c", "s", "a"):
        page.keyboard.press(key)
        changed()
    page.get_by_role("button", name="Oblique").click()
    changed()
    page.mouse.move(*middle)
    assert drawing(page) == seen[-1], "nothing turns that is not asked to"


def test_a_view_is_the_same_every_time(opened: Open, person: str) -> None:
    page = opened(person)
    shown = []
    for name in ("Camera", "Side", "Above", "Camera"):
        page.get_by_role("button", name=name, exact=True).click()
        shown.append(drawing(page))
    assert shown[0] == shown[3]
    assert len(set(shown)) == 3


def test_hypotheses_stand_alone_or_together(opened: Open, person: str) -> None:
    page = opened(person)
    buttons = page.locator("#hypotheses button")
    assert buttons.count() == 5

    def pressed() -> list[str]:
        return buttons.evaluate_all("all => all.map(one => one.getAttribute('aria-pressed'))")

    assert pressed() == ["true"] * 5
    together = drawing(page), drawing(page, "#photo")
    page.get_by_role("button", name="One by one").click()
    assert pressed() == ["true", *["false"] * 4]
    alone = drawing(page), drawing(page, "#photo")
    assert alone[0] != together[0]
    assert alone[1] != together[1]
    page.keyboard.press("Escape")
    page.locator("body").press("n")
    assert pressed() == ["false", "true", *["false"] * 3]
    page.get_by_role("button", name="All together").click()
    assert pressed() == ["true"] * 5
    assert (drawing(page), drawing(page, "#photo")) == together
    buttons.nth(2).click()
    assert pressed().count("true") == 4


def test_draws_and_truth_can_be_hidden(opened: Open, person: str) -> None:
    page = opened(person)
    before = drawing(page)
    page.locator("#draws").fill("0")
    without = drawing(page)
    assert without != before
    assert page.locator("#draws-said").inner_text() == "0"
    page.locator("#truth").uncheck()
    assert drawing(page) != without


def test_a_joint_that_is_touched_shows_its_marginals(opened: Open, person: str) -> None:
    page = opened(person)
    page.locator("#joint").select_option(label="head")
    head = page.locator("#marginals").inner_text()
    bars = page.locator("#marginals svg rect").count()
    assert bars == 3 * 2 * 48
    data = page.evaluate("JSON.parse(document.getElementById('data').textContent)")
    wrist = data["joints"].index("left wrist")
    low, high = np.array(data["window"]).reshape(2, 2)
    place = np.array(data["detection"]["points"][wrist])
    box = page.locator("#photo").bounding_box()
    scale = min(box["width"] / (high - low)[0], box["height"] / (high - low)[1])
    aside = (box["width"] - scale * (high - low)[0]) / 2
    page.mouse.click(
        box["x"] + aside + scale * (place - low)[0], box["y"] + scale * (place - low)[1]
    )
    shown = int(page.locator("#joint").input_value())
    assert data["joints"][shown].startswith("left"), "the wrist, or a hypothesis beside it"
    assert page.locator("#marginals").inner_text() != head
    words = page.locator("#marginals figure p").first.inner_text()
    assert words == data["marginals"]["depth"][shown]["words"]


def test_a_film_plays_and_its_slider_moves(opened: Open, film: str) -> None:
    page = opened(film)
    said = page.locator("#frame-said")
    assert "(1 of 8)" in said.inner_text()
    first = drawing(page)
    page.locator("#frame").fill("4")
    assert "(5 of 8)" in said.inner_text()
    assert drawing(page) != first
    page.locator("#frame").press("ArrowRight")
    assert "(6 of 8)" in said.inner_text()
    page.locator("#scene").press("p")
    assert "(5 of 8)" in said.inner_text()
    page.locator("#frame").fill("1")
    assert "too little of <script>" in said.inner_text()
    page.locator("#rate").select_option("50")
    page.get_by_role("button", name="Play").click()
    page.locator("#play:text-is('Play')").wait_for()  # it has come to the end
    assert "(8 of 8)" in said.inner_text()
    page.locator("#bands").click(position={"x": 60, "y": 60})
    assert "(1 of 8)" in said.inner_text()


def test_bands_are_drawn_for_every_stretch(opened: Open, film: str) -> None:
    page = opened(film)
    stretches = 2  # the second frame has no pose
    assert page.locator("#bands polygon").count() == 2 * stretches
    before = page.locator("#bands polyline").first.get_attribute("points")
    page.locator("#joint").select_option(label="left ankle")
    assert page.locator("#bands polyline").first.get_attribute("points") != before


def centre(page: "Page", name: str) -> tuple[float, float]:
    page.locator(name).scroll_into_view_if_needed()
    box = page.locator(name).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@pytest.mark.parametrize("kind", ["person", "film"])
def test_values_stand_beside_the_pointer(opened: Open, person: str, film: str, kind: str) -> None:
    page = opened(person if kind == "person" else film)
    tip = page.locator("#tip")
    assert not tip.is_visible()
    centre(page, "#scene")
    settle(page)
    box, found = page.locator("#scene").bounding_box(), ""
    for across in range(10, int(box["width"]), 12):  # bodies are in the middle of the scene
        for down in (0.35, 0.45, 0.55, 0.65):
            page.mouse.move(box["x"] + across, box["y"] + down * box["height"])
            if tip.is_visible():
                found = tip.inner_text()
    assert re.search(r"depth [+−]?\d+\.\d\d, across [+−]?\d+\.\d\d, height", found)
    page.mouse.move(2, 2)
    assert not tip.is_visible()


def test_the_wheel_enlarges_the_scene_and_scrolls_elsewhere(opened: Open, person: str) -> None:
    page = opened(person, viewport={"width": 1280, "height": 500})
    before = drawing(page)
    page.mouse.move(*centre(page, "#photo"))
    at = page.evaluate("scrollY")
    page.mouse.wheel(0, 60)
    page.wait_for_function(f"scrollY > {at}")
    assert drawing(page) == before
    page.mouse.move(*centre(page, "#scene"))
    at = page.evaluate("scrollY")
    page.mouse.wheel(0, -60)
    assert drawing(page) != before
    assert page.evaluate("scrollY") == at


@pytest.mark.parametrize("kind", ["person", "film"])
def test_fingers_find_every_control(opened: Open, person: str, film: str, kind: str) -> None:
    """44 CSS pixels each way (WCAG 2.5.5); of a checkbox its label is the target."""
    page = opened(person if kind == "person" else film, viewport=PHONE, has_touch=True)
    for one in page.locator("button, select, input[type=range], #truth-choice").all():
        box = one.bounding_box()
        if box is not None:
            assert min(box["width"], box["height"]) >= 44, one.evaluate("one => one.outerHTML")


@pytest.mark.parametrize("kind", ["person", "film"])
def test_a_phone_shows_all_of_it(opened: Open, person: str, film: str, kind: str) -> None:
    page = opened(person if kind == "person" else film, viewport=PHONE, has_touch=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    before = drawing(page)
    page.locator("#scene").scroll_into_view_if_needed()
    page.get_by_role("button", name="Side", exact=True).tap()
    assert drawing(page) != before


def test_paper_gets_the_pictures_and_not_the_controls(opened: Open, person: str) -> None:
    page = opened(person)
    page.emulate_media(media="print")
    settle(page)
    assert page.locator("#scene").is_visible()
    assert page.locator("#hypotheses").is_visible()
    assert not page.locator("#draws").is_visible()


def test_a_script_that_is_not_ours_is_not_run(
    browser: "Browser", person: str, tmp_path: Path
) -> None:
    """The control: even unescaped, a script of a file would be refused, and the console says so."""
    spoilt = person.replace("<noscript>", "<script>document.title = 'taken'</script><noscript>")
    write_page(spoilt, tmp_path / "page.html")
    page, said = browser.new_page(), []
    page.on("console", lambda message: said.append(message.text))
    page.goto((tmp_path / "page.html").as_uri())
    assert page.title() != "taken"
    assert any("Content Security Policy" in text for text in said)
    page.close()
