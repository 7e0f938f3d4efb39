"""Sols are played one after the other, and the playback is saved as a video and as a GIF."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.browsing import at, keep_screenshot, look, until


def shown(page) -> str:
    return page.locator(".sol-summary output").inner_text()


def open_dialog(page) -> None:
    page.get_by_role("button", name="Save…").click()
    page.locator("dialog .playback").wait_for()
    page.get_by_label("seconds a frame").fill("0.4")


def save(page, ending: str, folder: Path) -> Path:
    page.locator("dialog select").select_option(ending)
    with page.expect_download(timeout=120_000) as download:
        page.locator("dialog").get_by_role("button", name="Save", exact=True).click()
    path = folder / download.value.suggested_filename
    download.value.save_as(path)
    until(page, lambda: page.locator("dialog output").inner_text() == "saved 2 frames")
    return path


@pytest.fixture
def footprints(page, url):
    look(page, url + at(0.1, "mer2/footprints,mer2/orthophoto"))
    return page


def test_a_gif_has_one_frame_per_sol(footprints, tmp_path):
    open_dialog(footprints)
    keep_screenshot(footprints, "playback-dialog")
    path = save(footprints, "gif", tmp_path)
    assert shown(footprints) == "all sols"
    film = cv2.VideoCapture(str(path))
    frames = [film.read()[1] for _ in range(int(film.get(cv2.CAP_PROP_FRAME_COUNT)))]
    assert len(frames) == 2
    first, second = (frame.astype(int) for frame in frames)
    changed = np.abs(first - second).max(axis=2) > 60
    assert 500 < changed.sum() < 0.2 * changed.size  # other footprints on the same ground


def test_a_video_shows_every_sol_for_the_chosen_duration(footprints, tmp_path):
    ffprobe = shutil.which("ffprobe")
    if ffprobe is None:
        pytest.skip("ffprobe is not installed")
    footprints.get_by_label("keep earlier sols").check()
    open_dialog(footprints)
    path = save(footprints, "webm", tmp_path)
    reported = subprocess.run(
        [ffprobe, "-v", "error", "-show_packets", "-show_streams", "-of", "json", path],
        capture_output=True,
        check=True,
    )
    found = json.loads(reported.stdout)
    (stream,) = found["streams"]
    assert stream["codec_type"] == "video"
    assert stream["width"] % 2 == stream["height"] % 2 == 0
    assert [float(one["pts_time"]) for one in found["packets"]] == [0.0, 0.4]
    film = cv2.VideoCapture(str(path))
    frames = []
    while (read := film.read())[0]:
        frames.append(read[1].astype(int))
    assert (np.abs(frames[0] - frames[-1]).max(axis=2) > 60).sum() > 500


def test_closing_the_dialog_saves_nothing_and_restores_the_sols(footprints):
    footprints.get_by_label("last sol").press("ArrowLeft")
    open_dialog(footprints)
    footprints.get_by_label("seconds a frame").fill("5")
    footprints.locator("dialog").get_by_role("button", name="Save", exact=True).click()
    footprints.keyboard.press("Escape")
    until(footprints, lambda: footprints.locator("dialog[open]").count() == 0)
    until(footprints, lambda: shown(footprints) == "sol 155")
