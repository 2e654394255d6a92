"""The page of a report, opened in a browser."""

import re
import shutil

import numpy as np
import pytest
from playwright.sync_api import expect, sync_playwright
from report_clips import EVIL, GAP, SPIKE, large, recovery_of
from report_clips import planted as make_planted

from motionrecover.motion import Motion
from motionrecover.report import write_report
from motionrecover.report.account import feet
from motionrecover.report.payload import STEP
from motionrecover.robust import Change
from motionrecover.skeleton import Skeleton
from motionrecover.synthetic import synthesize


@pytest.fixture(scope="module")
def planted():
    return make_planted()


@pytest.fixture(scope="module")
def browser():
    """A browser of this machine, that draws without a graphics card."""
    found = [path for path in map(shutil.which, ("chromium", "google-chrome", "chromium-browser")) if path]
    if not found:
        pytest.skip("no chromium, google-chrome or chromium-browser on PATH: no page is opened")
    with sync_playwright() as playwright:
        flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        opened = playwright.chromium.launch(executable_path=found[0], args=flags)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def open_report(browser, tmp_path_factory):
    """Writes a report, opens it and checks that nothing goes wrong or out over the network."""
    pages = []

    def call(clip, recovery, **options):
        path = tmp_path_factory.mktemp("page") / "report.html"
        write_report(clip, recovery, path, **options)
        page, wrong = browser.new_page(viewport={"width": 1000, "height": 700}), []
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("dialog", lambda dialog: (wrong.append(dialog.message), dialog.dismiss()))
        page.on("request", lambda request: wrong.append(request.url) if request.url.startswith("http") else None)
        page.goto(path.as_uri())
        page.wait_for_selector("body[data-ready]", timeout=60_000)
        pages.append((page, wrong))
        return page

    yield call
    for _, wrong in pages:
        assert not wrong


@pytest.fixture(scope="module")
def page(open_report, planted):
    clip, recovery, truth = planted
    return open_report(clip, recovery, truth=truth, title=EVIL, settings={"preset": EVIL})


def joints_of(page, trace):
    """Joints (joint, 3) of a trace of the scene."""
    coordinates = page.evaluate(f"() => [scene.data[{trace}].x, scene.data[{trace}].y, scene.data[{trace}].z]")
    return np.array(coordinates, float).T


def slide_to(page, frame):
    page.locator("#slider").evaluate("(s, v) => { s.value = v; s.dispatchEvent(new Event('input')); }", frame)
    expect(page.locator("#now")).to_have_text(re.compile(f"^frame {frame} "))
    page.evaluate("showPose(view.index)")  # comes back when it is drawn


def changes(page):
    """The heat map as drawn: kind of change and more (joint, column), and the frame of each."""
    return (
        np.array(page.evaluate("document.querySelector('#changes .js-plotly-plot').data[0].z")),
        np.array(page.evaluate("document.querySelector('#changes .js-plotly-plot').data[0].customdata")),
    )


def test_the_page_opens_at_the_first_moment_and_shows_the_verdict(page):
    assert page.locator("h1").text_content() == "Usable, with moments to check"
    assert page.locator("#now").text_content() == "frame 90 · 1.50 s"
    assert page.locator("#moments button").count() == 3
    assert page.locator("#moments").text_content().count(EVIL) == 1
    assert EVIL in page.locator("#joint").text_content()


def test_the_slider_moves_the_skeleton(page, planted):
    _, recovery, _ = planted
    drawn, pictures = [], []
    for frame in (10, 60):
        slide_to(page, frame)
        drawn.append(joints_of(page, 4))
        pictures.append(page.locator("#skeletons").screenshot())
        true = recovery.positions[frame]
        np.testing.assert_allclose(drawn[-1] - drawn[-1][0], true - true[0], atol=2 * STEP)
        assert drawn[-1][:, 1] == pytest.approx(true[:, 1], abs=STEP)
    assert np.abs(drawn[0] - drawn[1]).max() > 0.05
    assert pictures[0] != pictures[1]
    assert len(pictures[0]) > 5000  # an empty scene has 2 kB


def test_the_input_is_as_it_came_and_lacks_what_was_missing(page, planted):
    clip = planted[0]
    for frame in (GAP[0].start - 1, GAP[0].start, GAP[0].stop - 1, GAP[0].stop, SPIKE[0]):
        slide_to(page, frame)
        drawn, came = joints_of(page, 2), clip.positions[frame]
        np.testing.assert_allclose(drawn - drawn[0], came - came[0], atol=2 * STEP)


def test_a_moment_takes_the_slider_to_its_frame(page):
    page.locator("#moments button", has_text="frame 70").click()
    assert page.locator("#slider").input_value() == "70"
    assert page.locator("#joint").input_value() == "4"
    assert page.locator("#moments li.here").count() == 1


def test_play_goes_on_in_time_and_stops(page):
    slide_to(page, 0)
    page.locator("#play").click()
    expect(page.locator("#now")).not_to_have_text(re.compile("^frame [0-5] "))
    assert page.locator("#play").text_content() == "Pause"
    page.locator("#play").click()
    assert page.locator("#play").text_content() == "Play"


def test_the_heat_map_shows_what_was_planted(page, planted):
    _, recovery, _ = planted
    drawn, frames = changes(page)
    assert drawn.shape == (25, 120)
    np.testing.assert_array_equal(np.floor(drawn).T, recovery.changed)
    np.testing.assert_array_equal(frames, np.tile(np.arange(120), (25, 1)))
    assert drawn[SPIKE[1], SPIKE[0]] > 2
    said = page.evaluate("document.querySelector('#changes .js-plotly-plot').data[0].text")[SPIKE[1]][SPIKE[0]]
    assert said == "<b>&lt;script&gt;alert(1)&lt;/script&gt;</b>, frame 70<br>repaired, moved 300 mm"


def test_menus_choose_joint_and_bone(page, planted):
    _, recovery, _ = planted
    page.locator("#joint").select_option("7")
    curves = page.evaluate("document.querySelector('#trajectory .js-plotly-plot').data.map(t => t.y)")
    np.testing.assert_allclose(curves[-1], recovery.positions[:, 7, 0], atol=STEP)
    page.locator("#bone").select_option("3")
    curves = page.evaluate("document.querySelector('#bones .js-plotly-plot').data.map(t => t.y)")
    np.testing.assert_allclose(curves[-1], recovery.bone_lengths[3], atol=3 * STEP)


def test_the_band_is_as_wide_as_the_uncertainty(page, planted):
    _, recovery, _ = planted
    page.locator("#joint").select_option(str(GAP[1]))
    low, high = page.evaluate("document.querySelector('#trajectory .js-plotly-plot').data.slice(0, 2).map(t => t.y)")
    expected = 4 * recovery.uncertainty[:, GAP[1]] / np.sqrt(3)
    np.testing.assert_allclose(np.subtract(high, low), expected, atol=2 * STEP)


def test_feet_swaps_and_parameters_are_told(page, planted):
    clip, recovery, _ = planted
    steps = feet(clip, recovery)
    drawn = np.array(page.evaluate("document.querySelector('#feet .js-plotly-plot').data[0].z"), float)
    np.testing.assert_allclose(drawn.T, steps.speeds, atol=STEP)
    text = page.locator("main").text_content()
    assert "frames 90 to 99" in text
    assert f"preset{EVIL}" in text


def test_a_spike_of_one_frame_is_seen_among_ten_thousand(open_report):
    page = open_report(*large(10_000))
    drawn, frames = changes(page)
    assert drawn.shape[1] < 1000
    repaired = np.argwhere(np.floor(drawn) == Change.REPAIRED)
    assert repaired.tolist() == [[49, 7001 * drawn.shape[1] // 10_000]]
    assert frames[tuple(repaired[0])] == 7001
    curves = page.evaluate("document.querySelector('#trajectory .js-plotly-plot').data.map(t => t.x)")
    assert 7001 in curves[-2]
    page.evaluate("zoom(6990, 7010)")
    drawn, frames = changes(page)
    assert frames[0].tolist() == list(range(6990, 7011))
    assert np.argwhere(np.floor(drawn) == Change.REPAIRED).tolist() == [[49, 11]]


@pytest.mark.parametrize("kind", ["one frame", "markers, one never seen"])
def test_odd_clips_open_too(open_report, kind):
    body = synthesize(1, 30)
    positions, skeleton = body.positions[:1], body.skeleton
    if kind != "one frame":
        positions, skeleton = body.positions[:, :3].copy(), Skeleton(["one", "two", "three"])
        positions[:, 1] = np.nan
    clip = Motion(positions, skeleton, 30.0)
    page = open_report(clip, recovery_of(clip, clip.positions, np.ones(clip.observed.shape)))
    assert changes(page)[0].shape == (len(skeleton.names), len(positions))
