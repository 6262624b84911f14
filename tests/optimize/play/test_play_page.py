"""The page to play with says what the model says, and every way of moving light works."""

from __future__ import annotations

import base64
import html
import io
import json
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.image import imread

from optimize.design import Design, baseline_design, limits_of, load_layout, open_rated
from optimize.play import MAX_BYTES, PlayPage, play_page, write_play
from optimize.play.page_data import packed
from optimize.readers import CameraModel, PlaceError, SensorError
from optimize.report import encode_srgb
from optimize.scoring import TableScorer, open_model, predicted_colors, search_table
from optimize.search import ReaderObjective, refine_by, refine_locally
from optimize.search.colors import quick_colors
from render.chebyshev import chebyshev_nodes
from render.errors import TableError
from render.geometry import bolt
from render.preview import Preview
from render.scene import Scene, load_scene, unchecked
from surrogate.runtime import Checker
from tests.optimize.browser import SCREENS, look
from tests.optimize.browser import opened as opened_page

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, LocatorAssertions, Page

BOUND = 0.02
"""Counts by which a score of the page may differ from checker.onnx."""


HOSTILE = "tactilux play <meta http-equiv=refresh content=0>.toml"


def known_good(scene: Scene) -> Design:
    """Return a design better than the baseline, to a degree what explore finds."""
    colors = [0, 0, 0, 0, 2, 0, 0, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 0, 0]
    degrees = [69, 78, 100, 110, 100, 80, 100, 100, 76, 89]
    degrees += [102, 111, 100, 109, 84, 80, 104, 87, 68, 75]
    return Design.of_colors(np.radians(degrees), colors)


@pytest.fixture(scope="module")
def written(
    finger20: Scene, finger20_checker: Checker, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("play") / "page.html"
    page = PlayPage(finger20, finger20_checker, optimum=known_good(finger20), command=HOSTILE)
    write_play(path, page)
    return path


@pytest.fixture(scope="module")
def opened(chromium: Browser, written: Path) -> Iterator[Callable[[str], Page]]:
    """Open the page, with something behind its address, without a network."""
    with chromium.new_context(viewport={"width": 1280, "height": 1100}, offline=True) as context:
        context.set_default_timeout(120_000)  # of a busy machine

        def open_page(fragment: str = "") -> Page:
            page = context.new_page()
            page.goto(written.as_uri() + fragment)
            return page

        yield open_page


@pytest.fixture
def play(opened: Callable[[str], Page]) -> Iterator[Page]:
    page = opened("")
    yield page
    page.close()


def design_of(page: Page) -> dict[str, Any]:
    found: dict[str, Any] = page.evaluate("tactilux.design()")
    return found


def designed(page: Page) -> Design:
    found = design_of(page)
    return Design(np.radians(found["angles_deg"]), np.array(found["power"]))


def score_of(page: Page) -> float:
    return float(design_of(page)["score"]["value"])


def shown(part: Locator) -> LocatorAssertions:
    """Return what is asserted of a part, which the next frames may bring."""
    from playwright.sync_api import expect

    expect.set_options(timeout=60_000)
    return expect(part)


def wait(page: Page, expression: str, seconds: float) -> None:
    """Wait until an expression is true; the page's policy forbids Playwright's own way."""
    end = time.monotonic() + seconds
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"{expression} is not true after {seconds} s"
        page.wait_for_timeout(100)


def drag(page: Page, start: tuple[float, float], end: tuple[float, float]) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=4)
    page.mouse.up()


def middle(page: Page, selector: str, number: int = 0) -> tuple[float, float]:
    box = page.locator(selector).nth(number).bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_a_page_says_that_its_pictures_do_not_know_the_lobe_of_a_skin(finger20: Scene) -> None:
    glossy = unchecked(finger20.coating, {"specular": 0.2, "roughness": 0.3})
    trained: Any = SimpleNamespace(metadata=SimpleNamespace(rendered=True))
    page = PlayPage(unchecked(finger20, {"coating": glossy}), trained)
    assert [note for note in page.notes if "lobe" in note]
    assert PlayPage(finger20, trained).notes == []


def test_tables_survive_sixteen_bits_to_half_a_step() -> None:
    rng = np.random.default_rng(0)
    tables = {"first": rng.uniform(0, 7, (3, 4)), "second": rng.uniform(0, 1e-4, 5)}
    text, places = packed(tables)
    whole = np.frombuffer(base64.b64decode(text), dtype="<u2").astype(np.float64)
    for name, table in tables.items():
        place = places[name]
        part = whole[int(place["first"]) : int(place["first"] + place["count"])] * place["step"]
        np.testing.assert_allclose(part, table.ravel(), atol=0.501 * table.max() / 65535, rtol=0)


def test_it_is_one_file_below_three_megabytes_with_a_strict_policy(written: Path) -> None:
    text = written.read_text()
    assert len(text.encode()) < MAX_BYTES
    assert "unsafe" not in text
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    assert policy[1].startswith("default-src &#39;none&#39;") or policy[1].startswith(
        "default-src 'none'"
    )
    assert not re.search(r"(?:src|href)=", text)


def test_a_thousand_scores_are_those_of_the_model(
    play: Page, finger20: Scene, finger20_checker: Checker
) -> None:
    rng = np.random.default_rng(1)
    phi, colors = rng.uniform(0, np.pi, (1000, 20)), rng.integers(0, 4, (1000, 20))
    power = np.eye(4)[colors][..., :3] * rng.uniform(0, 1, (1000, 20, 1))
    bends = np.array(finger20.bending.angles)
    said = finger20_checker.run(phi, power, bends)["score"]
    found = play.evaluate(
        "([phi, power]) => phi.map((p, i) => tactilux.rate(p, power[i]).score)",
        [np.degrees(phi).tolist(), power.tolist()],
    )
    assert np.abs(np.array(found) - said).max() < BOUND


@pytest.mark.parametrize("screen", SCREENS)
def test_it_fits_the_screen_and_asks_for_nothing_but_itself(
    chromium: Browser, written: Path, screen: str
) -> None:
    seen = look(chromium, written, screen)
    assert seen.page <= 0
    assert seen.wide == []
    assert seen.small == []
    assert seen.requests == []
    # What the software rasterizer tells of reading screenshots is no complaint of the page.
    assert [text for text in seen.complaints if "GPU stall" not in text] == []
    assert len(np.unique(seen.shot)) > 50


def test_the_policy_stops_foreign_scripts_and_requests(play: Page) -> None:
    assert play.evaluate(
        """() => new Promise((done) => {
            const refused = [];
            document.addEventListener("securitypolicyviolation", (event) => {
                refused.push(event.effectiveDirective);
                if (refused.length === 2) done(refused.sort());
            });
            const script = document.createElement("script");
            script.textContent = "window.intruder = true";
            document.body.append(script);
            fetch("https://example.com").catch(() => {});
        })"""
    ) == ["connect-src", "script-src-elem"]
    assert play.evaluate("window.intruder") is None


def test_dragging_a_beam_turns_it_and_undo_turns_it_back(play: Page) -> None:
    before = design_of(play)
    lamp = middle(play, ".lamp .bulb", 3)
    tip = middle(play, ".lamp .tip", 3)
    drag(play, tip, (lamp[0] + 60, lamp[1] - 60))
    after = design_of(play)
    assert after["angles_deg"][3] == pytest.approx(45.0, abs=1.5)
    assert after["score"]["value"] != before["score"]["value"]
    rest = [angle for fiber, angle in enumerate(after["angles_deg"]) if fiber != 3]
    assert rest == pytest.approx([90.0] * 19)
    play.keyboard.press("Control+z")
    assert design_of(play) == before
    play.get_by_role("button", name="Redo").click()
    assert design_of(play) == after


def test_a_click_takes_the_next_color_and_off_comes_after_blue(play: Page) -> None:
    colors = [design_of(play)["colors"][0]]
    for _ in range(4):
        play.mouse.click(*middle(play, ".lamp .bulb", 0))
        colors.append(design_of(play)["colors"][0])
    assert colors == ["red", "green", "blue", "off", "red"]
    shown(play.locator(".lamp .letter").nth(0)).to_have_text("R")


def test_the_keyboard_alone_turns_recolors_and_dims_a_lamp(play: Page) -> None:
    lamp = play.get_by_role("slider", name="Fiber 5, left edge")
    lamp.focus()
    for key in ("ArrowUp", "Shift+ArrowUp", "PageDown", "b", "-"):
        play.keyboard.press(key)
    design = design_of(play)
    assert design["angles_deg"][5] == pytest.approx(90 + 1 + 5 - 10)
    assert design["power"][5] == pytest.approx([0, 0, 0.95])
    shown(lamp).to_have_attribute("aria-valuetext", "blue, 86 degrees, 95 percent power")
    play.keyboard.press("o")
    assert design_of(play)["colors"][5] == "off"


def test_keys_faster_than_frames_are_all_obeyed(play: Page) -> None:
    play.evaluate(
        """() => {
            const press = (selector, key) => document.querySelector(selector)
                .dispatchEvent(new KeyboardEvent("keydown", { key }));
            for (let i = 0; i < 7; i++) press(".lamp", "ArrowUp");
            for (let i = 0; i < 3; i++) press(".touch", "ArrowRight");
        }"""
    )
    assert design_of(play)["angles_deg"][0] == pytest.approx(97.0)
    shown(play.locator(".touch")).to_have_attribute("aria-label", re.compile(r"at 1\.5, "))


def test_a_finger_turns_a_lamp(chromium: Browser, written: Path) -> None:
    width, height, density, _ = SCREENS["phone"]
    with chromium.new_context(
        viewport={"width": width, "height": height},
        device_scale_factor=density,
        is_mobile=True,
        has_touch=True,
    ) as context:
        page = context.new_page()
        page.goto(written.as_uri())
        x, y = middle(page, ".lamp .tip", 14)
        bulb = middle(page, ".lamp .bulb", 14)
        client = context.new_cdp_session(page)
        for kind, points in (
            ("touchStart", [{"x": x, "y": y}]),
            ("touchMove", [{"x": x, "y": y + 10}]),
            ("touchMove", [{"x": bulb[0] - 40, "y": bulb[1] + 40}]),
            ("touchEnd", []),
        ):
            client.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        wait(page, "Math.abs(tactilux.design().angles_deg[14] - 135) < 3", 30)


def test_uphill_ends_where_no_search_of_ours_finds_more(
    play: Page, finger20: Scene, finger20_checker: Checker
) -> None:
    play.get_by_role("button", name="Push uphill").click()
    wait(play, "!tactilux.climbing()", 600)
    design = designed(play)
    limits = limits_of(finger20)
    assert limits.fits_holder(design.phi)
    scorer = TableScorer(search_table(finger20_checker), limits=limits)
    goal = ReaderObjective(scorer, finger20, "sensor", CameraModel.of(finger20))
    reached = -goal.value(design)
    assert design_of(play)["read"]["reader_error_deg"] == pytest.approx(reached, rel=1e-3)
    assert reached < 0.7 * -goal.value(baseline_design(finger20))
    assert -refine_by(scorer, goal, design).score > 0.99 * reached
    # Whatever one click on a lamp does from there does not help.
    for f in range(20):
        for led in range(4):
            drive = design.drive.copy()
            drive[f] = np.arange(3) == led
            assert -goal.value(replace(design, drive=drive)) > 0.999 * reached


def test_uphill_lights_a_lamp_that_was_darkened_where_that_is_better(play: Page) -> None:
    for _ in range(3):
        play.mouse.click(*middle(play, ".lamp .bulb", 3))
    start = design_of(play)
    assert start["colors"][3] == "off"
    read = "([a, p]) => tactilux.rate(a, p).sensor"
    lit = [[[float(c == led) for c in range(3)] if f == 3 else power
            for f, power in enumerate(start["power"])] for led in range(3)]  # fmt: skip
    best = min(play.evaluate(read, [start["angles_deg"], power]) for power in lit)
    assert best < start["read"]["reader_error_deg"]
    play.get_by_role("button", name="Push uphill").click()
    wait(play, f"tactilux.design().read.reader_error_deg < {best}", 300)
    play.get_by_role("button", name="Stop").click()


READ_WITHIN = 3e-4
"""Relative: tables of the page have 16 bits, and weights of colors 6 decimals."""


@pytest.fixture(scope="module", params=["finger20", "digit", "digit, two shots"])
def read_scene(
    request: pytest.FixtureRequest,
    chromium: Browser,
    written: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[Scene, Checker, Page]]:
    """Return sensors with their pages: lamps that turn, a camera of few gains, and of two shots."""
    name, _, shots = request.param.partition(", ")
    scene = load_scene(name)
    if shots:
        scene = scene.with_(camera_shots=2)
    checker = open_model(scene, coarse=bool(shots))
    path = written
    if scene.name != "finger20":
        few = () if shots else (1.0, 2.0, 8.0)
        camera = unchecked(scene.camera, {"gains": few or None, "read_noise": 2.0, "bits": 10})
        scene = unchecked(scene, {"camera": camera})
        path = tmp_path_factory.mktemp("read") / "page.html"
        write_play(path, PlayPage(scene, checker))
    with opened_page(chromium, path) as page:
        yield scene, checker, page


def random_designs(scene: Scene) -> list[Design]:
    """Return the baseline, random allowed designs, a dim one, and one that is dark."""
    rng, lamps = np.random.default_rng(4), scene.lamp_count
    limits, designs = limits_of(scene), [baseline_design(scene)]
    one = np.eye(len(scene.palette.names))
    for power in (1.0, 1.0, 1.0, 0.7, 0.7, 0.02, 0.0):
        phi = limits.nearest_directions(rng.uniform(0.0, np.pi, lamps))
        colors = rng.integers(0, len(one), lamps)
        drive = one[colors] * rng.uniform(0.5 * power, power, (lamps, 1))
        designs.append(Design(phi, drive, scene.palette))
    return designs


def plain(design: Design) -> list[Any]:
    return [np.degrees(design.phi).tolist(), design.drive.tolist()]


def test_degrees_are_those_of_the_program(read_scene: tuple[Scene, Checker, Page]) -> None:
    scene, checker, page = read_scene
    camera, seen = CameraModel.of(scene), []
    errors = {"sensor": SensorError(scene, camera), "place": PlaceError(scene, camera)}
    for design in random_designs(scene):
        counts = predicted_colors(checker, design)[None]
        factor, gain, _ = camera.exposed(counts.reshape(1, -1))
        said = page.evaluate("([a, p]) => tactilux.rate(a, p)", plain(design))
        for name, error in errors.items():
            truth = float(error.degrees(counts)[0])
            assert said[name] == pytest.approx(truth, rel=READ_WITHIN)
            seen.append(truth)
        assert said["factor"] == pytest.approx(factor[0], rel=READ_WITHIN)
        assert said["gain"] == pytest.approx(gain[0], rel=READ_WITHIN)
    assert max(seen) > 3.0 * min(seen)


def test_slopes_of_degrees_are_those_of_the_program(
    read_scene: tuple[Scene, Checker, Page],
) -> None:
    scene, checker, page = read_scene
    table = checker.transport_table(chebyshev_nodes(play_page.PHI_NODES, 0.0, np.pi))
    goal = ReaderObjective(TableScorer(table), scene, "sensor", CameraModel.of(scene))
    rng = np.random.default_rng(6)
    for design in random_designs(scene)[1:]:
        # No two channels are brightest alike: either may decide the exposure, with its own slopes.
        other = rng.uniform(size=design.drive.shape) / design.drive.shape[1]
        design = replace(design, drive=0.5 * (design.drive + other))
        _, by_phi, by_power = goal.gradient(design)
        by_power = by_power @ scene.palette.matrix.T
        said = page.evaluate("([a, p]) => tactilux.slopes(a, p)", plain(design))
        for truth, found in ((by_phi, said["phi"]), (by_power, said["power"])):
            # Of 16 bits; differences of the nodes' values grow what they miss.
            bound = 5e-3 * np.abs(truth).max() + 1e-12
            np.testing.assert_allclose(np.reshape(found, truth.shape), truth, atol=bound, rtol=0)


def link(scene: Scene, design: Design) -> str:
    """Return what follows the address of a page that opens with ``design``."""
    values = np.column_stack([design.phi / np.pi, design.drive]).ravel()
    whole = np.round(65535 * values).astype(">u2").tobytes()
    return "#" + base64.urlsafe_b64encode(bytes.fromhex(scene.hash[:8]) + whole).decode().strip("=")


def test_climbing_never_ends_worse_than_where_it_began(
    read_scene: tuple[Scene, Checker, Page],
) -> None:
    scene, _, page = read_scene
    address = page.url.partition("#")[0]
    for design in random_designs(scene)[:4]:
        page.goto(address + link(scene, design))
        page.reload()
        before = page.evaluate("tactilux.design().read.reader_error_deg")
        page.get_by_role("button", name="Push uphill").click()
        end = time.monotonic() + 3.0  # stopped on its way it is no worse either
        while page.evaluate("tactilux.climbing()") and time.monotonic() < end:
            page.wait_for_timeout(200)
        if page.evaluate("tactilux.climbing()"):
            page.get_by_role("button", name="Stop").click()
        assert page.evaluate("tactilux.design().read.reader_error_deg") < before + 1e-9


def test_degrees_follow_a_lamp_while_it_is_dragged(play: Page) -> None:
    first = play.locator("#figure-sensor").text_content()
    assert first == f"{design_of(play)['read']['reader_error_deg']:.2f}°"
    lamp = middle(play, ".lamp .bulb", 3)
    play.mouse.move(*middle(play, ".lamp .tip", 3))
    play.mouse.down()
    play.mouse.move(lamp[0] + 20, lamp[1] - 90, steps=4)
    read = design_of(play)["read"]
    shown(play.locator("#figure-sensor")).to_have_text(f"{read['reader_error_deg']:.2f}°")
    shown(play.locator("#figure-place")).to_have_text(f"{read['normal_error_deg']:.2f}°")
    assert play.locator("#figure-sensor").text_content() != first
    play.mouse.up()


def test_a_page_for_the_score_names_it_first(
    chromium: Browser, finger20: Scene, finger20_checker: Checker, tmp_path: Path
) -> None:
    path, base = tmp_path / "page.html", baseline_design(finger20)
    page = PlayPage(finger20, finger20_checker, optimum=base, objective="score")
    write_play(path, page)
    with opened_page(chromium, path) as play:
        assert play.locator(".big .label").text_content() == "Score S"
        play.get_by_role("button", name="Push uphill").click()
        wait(play, "!tactilux.climbing()", 300)
        design = designed(play)
        scorer = TableScorer(search_table(finger20_checker), limits=limits_of(finger20))
        score = scorer.score(design.phi, design.power)
        assert design_of(play)["score"]["value"] == pytest.approx(score, abs=0.1)
        assert score > scorer.score(base.phi, base.power) + 30
        recolored = quick_colors(scorer, design.phi, starts=[design.colors], restarts=0)
        assert recolored.score < score + 0.05
        assert refine_locally(scorer, design).score < score + 0.1


def test_where_nothing_is_gained_baseline_and_optimum_stand_at_one_place(
    chromium: Browser, finger20: Scene, finger20_checker: Checker, tmp_path: Path
) -> None:
    path, base = tmp_path / "page.html", baseline_design(finger20)
    write_play(path, PlayPage(finger20, finger20_checker, optimum=base))
    with chromium.new_context(viewport={"width": 400, "height": 900}, offline=True) as context:
        page = context.new_page()
        page.goto(path.as_uri())
        left = [page.locator(f".tick.{name}").evaluate("tick => tick.style.left")
                for name in ("baseline", "optimum")]  # fmt: skip
        assert left == ["25%", "25%"]
        boxes = [page.locator(f".tick.{name}").bounding_box() for name in ("baseline", "optimum")]
        assert boxes[0] is not None
        assert boxes[1] is not None
        assert boxes[0]["x"] >= 0
        assert boxes[0]["x"] + boxes[0]["width"] <= boxes[1]["x"] + 1
        page.screenshot(path=tmp_path / "phone.png")


def test_the_saved_file_is_a_rated_design(
    play: Page, finger20: Scene, finger20_checker: Checker, tmp_path: Path
) -> None:
    play.mouse.click(*middle(play, ".lamp .bulb", 2))
    drag(play, middle(play, ".lamp .tip", 9), middle(play, ".lamp .tip", 10))
    with play.expect_download() as download:
        play.get_by_role("button", name="Save design.json").click()
    path = tmp_path / "design.json"
    download.value.save_as(path)
    rated = open_rated(path)
    said = finger20_checker.run(
        rated.design.phi[None], rated.design.power[None], np.array(finger20.bending.angles)
    )
    assert rated.rating.level == "surrogate"
    assert rated.rating.score == pytest.approx(float(said["score"][0]), abs=BOUND)
    low, high = rated.rating.interval
    assert high - low == pytest.approx(2 * finger20_checker.score_half_width)
    scene, layout = load_layout(path)
    assert scene.hash == finger20.hash
    np.testing.assert_array_equal(layout.phi, rated.design.phi)


def test_the_link_carries_the_design(play: Page, opened: Callable[[str], Page]) -> None:
    play.mouse.click(*middle(play, ".lamp .bulb", 2))
    drag(play, middle(play, ".lamp .tip", 9), middle(play, ".lamp .tip", 10))
    mine = design_of(play)
    other = opened("#" + play.evaluate("location.hash").removeprefix("#"))
    theirs = design_of(other)
    other.close()
    np.testing.assert_allclose(theirs["angles_deg"], mine["angles_deg"], atol=180 / 65535)
    assert theirs["colors"] == mine["colors"]
    assert theirs["score"]["value"] == pytest.approx(mine["score"]["value"], abs=0.01)


@pytest.mark.parametrize(
    ("fragment", "why"),
    [("#AAAAAAAA", "is damaged"), ("#%%", "is damaged"), ("foreign", "another")],
)
def test_a_link_of_something_else_is_left_out_with_a_sentence(
    play: Page, opened: Callable[[str], Page], fragment: str, why: str
) -> None:
    if fragment == "foreign":
        play.mouse.click(*middle(play, ".lamp .bulb", 2))
        raw = bytearray(base64.urlsafe_b64decode(play.evaluate("location.hash")[1:] + "=="))
        raw[0] ^= 255
        fragment = "#" + base64.urlsafe_b64encode(raw).decode().rstrip("=")
    page = opened(fragment)
    shown(page.locator("#said")).to_contain_text(why)
    assert set(design_of(page)["angles_deg"]) == {90.0}
    page.close()


def test_baseline_and_optimum_are_shown_and_an_edit_starts_from_them(
    play: Page, finger20: Scene
) -> None:
    first = score_of(play)
    play.get_by_label("Optimum").check()
    assert score_of(play) > first + 20
    play.get_by_label("Yours").check()
    assert score_of(play) == first
    play.get_by_label("Optimum").check()
    play.get_by_role("slider", name="Fiber 0, left edge").focus()
    play.keyboard.press("ArrowUp")
    good = np.degrees(known_good(finger20).phi)
    assert design_of(play)["angles_deg"] == pytest.approx([good[0] + 1, *good[1:]])
    shown(play.get_by_label("Yours")).to_be_checked()
    play.keyboard.press("Control+z")
    assert score_of(play) == first


def test_what_cannot_be_built_or_read_is_said(play: Page) -> None:
    for fiber in range(20):
        play.get_by_role("slider", name=re.compile(rf"^Fiber {fiber},")).focus()
        play.keyboard.press("r")
    shown(play.locator("#problems")).to_contain_text("One color")
    play.get_by_role("slider", name="Fiber 3, left edge").focus()
    play.keyboard.press("Home")
    shown(play.locator("#problems")).to_contain_text("meet in the holder")


def test_the_camera_sees_what_the_preview_draws(play: Page, finger20: Scene) -> None:
    base, width, height = baseline_design(finger20), 45, 75
    press = bolt(finger20)
    exposure = open_model(finger20).exposure
    with Preview(finger20, imprint=press) as preview:
        drawn = preview.picture(base.phi, base.power, np.pi / 2, width, height)
    expected = encode_srgb(np.asarray(drawn, np.float64) * exposure / 255).astype(np.float64)
    url = play.evaluate(
        "(a) => tactilux.picture(...a)", [0, 2, press.center[0, :2].tolist(), width, height]
    )
    seen = 255.0 * imread(io.BytesIO(base64.b64decode(url.partition(",")[2])))[..., :3]
    pad, shown = expected.sum(axis=-1) > 0, seen.sum(axis=-1) > 0
    assert (pad == shown).mean() > 0.99
    difference = np.abs(seen - expected)[pad & shown]
    assert difference.mean() < 6.0
    # Turned or mirrored it is another picture.
    assert np.abs(seen[:, ::-1] - expected)[pad & shown].mean() > 30.0


def test_a_page_too_large_for_a_mail_is_refused(
    finger20: Scene, finger20_checker: Checker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(play_page, "MAX_BYTES", 100_000)
    with pytest.raises(TableError, match=r"MB, allowed: below 0.1 MB; a scene with fewer sites"):
        PlayPage(finger20, finger20_checker, optimum=known_good(finger20)).html()


def test_words_of_strangers_in_a_page_are_text(written: Path) -> None:
    text = written.read_text()
    assert HOSTILE not in text
    assert html.escape(HOSTILE) in text


def test_names_in_a_page_cannot_end_its_script(written: Path) -> None:
    found = re.search(r'id="page">(.*?)</script>', written.read_text(), re.DOTALL)
    assert found is not None
    assert "<" not in found[1]
    assert json.loads(found[1])["scene"] == {"name": "finger20", "hash": "68471ad4c129ea4d"}
