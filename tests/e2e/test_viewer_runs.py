"""Runs, notes and signing in: annotations by people, and progress of the pipeline."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from solmap.products.catalogue.edits import EditKind, EditLog, RequestKind, RunRequests
from solmap.products.catalogue.engine_state import OLD_S, DeploymentState, EngineState
from solmap.products.catalogue.events import ENGINE_CHANGED
from solmap.products.catalogue.runs import Run, RunRecords, RunState
from solmap.products.catalogue.tokens import Role, Tokens
from solmap.products.model import ProductKind, Recipe
from tests.support.bowl_store import REGION
from tests.support.browsing import at, keep_screenshot, look, open_page, pixel_of, ready, until

RESOLUTION = 0.1


def sign_in(page, workspace, role: Role) -> None:
    _, text = Tokens.of(workspace.store.root).add("Ann", role)
    page.get_by_role("button", name="Sign in").click()
    page.locator('dialog input[type="password"]').fill(text)
    page.locator('dialog button[type="submit"]').click()
    until(page, lambda: f"Ann ({role})" in page.locator(".account").inner_text())


def test_the_progress_of_a_run_is_shown(page, workspace, live):
    look(page, live)
    page.locator('[data-tab="runs"]').click()
    book = RunRecords(workspace.catalogue.engine)
    run = Run.start("downlink", "sol 156").with_progress("match pairs", 3, 12)
    book.write(run)
    row = page.locator(f'[data-run="{run.id}"]')
    until(page, lambda: row.count() == 1)
    assert "match pairs, 3 of 12" in row.inner_text()
    assert float(row.locator("progress").get_attribute("value")) == 0.25
    book.write(run.with_progress("adjust", 1, 2))
    until(page, lambda: "adjust, 1 of 2" in row.inner_text())
    keep_screenshot(page, "runs")
    book.write(run.with_lines(["failed: one pair has no common light"]).with_end(RunState.FAILED))
    until(page, lambda: row.get_attribute("data-state") == "failed")
    row.get_by_role("button").click()
    assert "no common light" in page.locator("dialog pre").inner_text()


def test_a_quality_report_opens_in_the_page(page, workspace, live):
    body = b"<!doctype html><title>q</title><h1>sigma0 0.97</h1>"
    recipe = Recipe(ProductKind.REPORT, REGION)
    report = workspace.store.make(recipe, lambda path: path.write_bytes(body))
    workspace.catalogue.publish(pointers=[report])
    look(page, live)
    page.locator('[data-tab="runs"]').click()
    page.locator('[data-report="mer2"]').click()
    inner = page.frame_locator("dialog iframe").locator("h1")
    until(page, lambda: inner.count() == 1)
    assert inner.inner_text() == "sigma0 0.97"


def write_engine(workspace, age_s=0.0, **more):
    at = (datetime.now(UTC) - timedelta(seconds=age_s)).isoformat(timespec="milliseconds")
    weekly = DeploymentState(
        name="overall-adjustment/weekly",
        description="",
        is_paused=False,
        schedules=("0 3 * * 0",),
        next_run="2026-11-29T03:00:00+00:00",
        last_state="failed",
        last_ended_at="2026-11-22T03:10:00+00:00",
        pool=None,
        is_ready=True,
    )
    known = {"is_up": True, "has_inbox": True, "deployments": (weekly,), **more}
    EngineState(at, **known).write(workspace.store.root)
    workspace.catalogue.append_event(ENGINE_CHANGED, {"is_up": known["is_up"]})


def test_only_an_operator_starts_a_run_after_one_confirmation(page, workspace, live):
    look(page, live)
    page.locator('[data-tab="runs"]').click()
    assert page.locator("[data-start]").count() == 0
    write_engine(workspace, is_up=False, trouble="it was stopped")
    sign_in(page, workspace, Role.OPERATOR)
    for _ in range(2):
        page.locator('[data-start="region"]').click()
        assert page.locator('dialog [name="mission"]').input_value() == "MER2"
        page.locator('dialog button[type="submit"]').click()
        assert "merged to regions again" in page.locator("dialog").inner_text()
        assert "kept until solmap up runs" in page.locator("dialog").inner_text()
        page.locator("[data-confirm]").click()
        until(page, lambda: page.locator(".request").count() == 1)
        ready(page)
    assert "region of MER2, requested by Ann" in page.locator(".request").inner_text()
    assert len(RunRequests.of(workspace.store.root).requests()) == 1


@pytest.mark.parametrize(
    ("age", "stated"),
    [(None, "solmap up has never run on this store"), (OLD_S + 1.0, "solmap up last ran at")],
)
def test_a_missing_engine_is_stated_without_an_alarm(page, workspace, live, age, stated):
    if age is not None:
        write_engine(workspace, age)
    look(page, live)
    page.locator('[data-tab="runs"]').click()
    sign_in(page, workspace, Role.OPERATOR)
    hint = page.locator(".runs [role=status]")
    until(page, lambda: hint.count() == 1)
    assert hint.inner_text().startswith(f"This server shows the map and runs nothing: {stated}")
    assert page.locator("[data-start]").count() == 0
    assert page.get_by_role("heading", name="Deployments").count() == 0
    assert page.locator(".status").inner_text().strip() == "Server up"
    write_engine(workspace)
    until(page, lambda: "Engine up" in page.locator(".status").inner_text())
    assert page.locator("[data-start]").count() > 0


def test_invalid_parameters_do_not_reach_the_confirmation(page, workspace, live):
    write_engine(workspace)
    look(page, live)
    page.locator('[data-tab="runs"]').click()
    sign_in(page, workspace, Role.OPERATOR)
    page.locator('[data-start="fetch"]').click()
    page.locator('dialog [name="sols"]').fill("yesterday")
    page.locator('dialog button[type="submit"]').click()
    assert page.locator("[data-confirm]").count() == 0
    page.locator('dialog [name="sols"]').fill("155-157")
    keep_screenshot(page, "run-form")
    page.locator('dialog button[type="submit"]').click()
    page.locator("[data-confirm]").click()
    until(page, lambda: page.locator(".request").count() == 1)
    (requested,) = RunRequests.of(workspace.store.root).requests()
    assert requested.mission == "MER2"
    assert requested.parameters == {"sols": "155-157", "instruments": ["navcam"], "dry_run": False}


def test_runs_are_cancelled_and_retried_and_deployments_paused(page, workspace, live):
    write_engine(workspace)
    book = RunRecords(workspace.catalogue.engine)
    going = Run.start("downlink", "inbox", "f-1", {"settle_s": 2.0})
    failed = Run.start("region", "MER2", "f-2").with_end(RunState.FAILED)
    book.write(going)
    book.write(failed)
    look(page, live)
    page.locator('[data-tab="runs"]').click()
    assert page.locator("[data-action]").count() == 0
    sign_in(page, workspace, Role.OPERATOR)
    row = page.locator('[data-deployment="overall-adjustment/weekly"]')
    assert "2026-11-29 03:00 UTC" in row.inner_text()
    assert "failed, 2026-11-22 03:10 UTC" in row.inner_text()
    keep_screenshot(page, "run-control")
    requests = RunRequests.of(workspace.store.root)
    for place in (
        f'[data-run="{going.id}"] [data-action]',
        f'[data-run="{failed.id}"] [data-action]',
    ):
        page.locator(place).click()
        page.locator("[data-confirm]").click()
        page.locator("dialog[open]").wait_for(state="detached")
    row.get_by_role("button", name="Pause").click()
    page.locator("[data-confirm]").click()
    until(page, lambda: len(requests.requests()) == 3)
    assert [(one.kind, one.parameters) for one in requests.waiting()] == [
        (RequestKind.CANCEL, {"run": "f-1"}),
        (RequestKind.REGION, {}),
        (RequestKind.PAUSE, {"deployment": "overall-adjustment/weekly"}),
    ]


def cancel_button(page, workspace, live):
    """The button that cancels a run in progress, with an engine that is up and an operator."""
    write_engine(workspace)
    run = Run.start("downlink", "inbox", "f-1")
    RunRecords(workspace.catalogue.engine).write(run)
    look(page, live)
    page.locator('[data-tab="runs"]').click()
    sign_in(page, workspace, Role.OPERATOR)
    return page.locator(f'[data-run="{run.id}"] [data-action="cancel"]')


def test_a_refusal_is_shown_in_the_dialog_and_the_engine_is_listed(page, workspace, live):
    cancel = cancel_button(page, workspace, live)
    engine = page.locator('.status [data-part="engine"]')
    until(page, lambda: engine.inner_text() == "Engine up")
    cancel.click()
    write_engine(workspace, is_up=False, trouble="it was stopped")
    until(page, lambda: engine.inner_text() == "Engine down")
    page.locator("[data-confirm]").click()
    trouble = page.locator("dialog .error")
    until(page, lambda: "the engine is down: it was stopped" in trouble.inner_text())


def test_a_button_is_clicked_although_its_run_changes_meanwhile(page, workspace, live):
    cancel = cancel_button(page, workspace, live)
    cancel.hover()
    page.mouse.down()
    write_engine(workspace, is_up=False, trouble="it was stopped")
    engine = page.locator('.status [data-part="engine"]')
    until(page, lambda: engine.inner_text() == "Engine down")
    page.mouse.up()
    page.locator("[data-confirm]").wait_for()
    until(page, lambda: "it was stopped" in page.locator("#panel-runs").inner_text())


def test_failed_requests_are_repeated_without_a_reload(page, live):
    page.route("**/api/runs?*", lambda route: route.abort())
    page.route("**/api/runs", lambda route: route.abort())
    look(page, live)
    page.evaluate("window.stillTheSame = true")
    page.locator('[data-tab="runs"]').click()
    until(page, lambda: "does not answer" in page.locator(".banner").inner_text())
    assert page.get_by_role("heading", name="Runs").count() == 0
    page.unroute("**/api/runs?*")
    page.unroute("**/api/runs")
    page.locator(".banner button").click()
    until(page, lambda: page.get_by_role("heading", name="Runs", exact=True).count() == 1)
    assert page.locator(".banner").is_hidden()
    assert page.evaluate("window.stillTheSame")


def test_a_wrong_token_is_reported_and_not_kept(page, workspace, live):
    Tokens.of(workspace.store.root).add("Ann", Role.ANALYST)
    look(page, live)
    page.get_by_role("button", name="Sign in").click()
    page.locator('dialog input[type="password"]').fill("solmap_a_b")
    page.locator('dialog button[type="submit"]').click()
    until(page, lambda: "unknown, revoked" in page.locator("dialog .error").inner_text())
    page.reload()
    ready(page)
    assert page.locator(".account").inner_text().count("Sign in") == 1


def test_a_note_is_written_seen_by_others_deleted_and_restored(page, browser, workspace, live):
    with open_page(browser) as other:
        look(other, live)
        check_a_note(page, other, workspace, live)


def check_a_note(page, other, workspace, live):
    other.locator('[data-tab="notes"]').click()
    look(page, live + at(RESOLUTION, "mer2/hillshade"))
    page.locator('[data-tab="notes"]').click()
    assert page.locator("[data-shape]").count() == 0
    sign_in(page, workspace, Role.ANALYST)
    page.locator('[data-shape="point"]').click()
    x, y = pixel_of(page, 6.0, -4.0, RESOLUTION)
    page.mouse.click(x, y)
    page.locator("dialog textarea").fill("layered rock")
    page.locator('dialog button[type="submit"]').click()
    until(page, lambda: page.locator("[data-note]").count() == 1)
    (edit,) = EditLog.of(workspace.store.root).edits("MER2")
    assert edit.kind is EditKind.ANNOTATION
    assert edit.document["geometry"]["coordinates"] == pytest.approx([6.0, -4.0], abs=0.06)
    assert edit.author == "Ann"
    until(other, lambda: "layered rock" in other.locator("[data-note]").inner_text())
    keep_screenshot(page, "note")
    page.get_by_role("button", name="Delete").click()
    until(page, lambda: page.locator("[data-note]").count() == 0)
    until(other, lambda: other.locator("[data-note]").count() == 0)
    assert len(EditLog.of(workspace.store.root).edits("MER2")) == 2
    other.get_by_text("Deleted annotations").click()
    until(other, lambda: "layered rock" in other.locator("[data-deleted]").inner_text())
    assert "deleted by Ann" in other.locator("[data-deleted]").inner_text()
    assert other.get_by_role("button", name="Restore").count() == 0  # no account is signed in there
    page.get_by_text("Deleted annotations").click()
    page.locator("[data-deleted]").get_by_text("History").click()
    until(page, lambda: "written: layered rock" in page.locator("[data-deleted]").inner_text())
    keep_screenshot(page, "note-deleted")
    page.get_by_role("button", name="Restore").click()
    until(page, lambda: "layered rock" in page.locator("[data-note]").inner_text())
    until(page, lambda: page.locator("[data-deleted]").count() == 0)


@pytest.mark.both_browsers
def test_an_annotation_has_a_category_and_is_a_draft_until_it_is_published(page, workspace, live):
    look(page, live + at(RESOLUTION, "mer2/hillshade"))
    page.locator('[data-tab="notes"]').click()
    sign_in(page, workspace, Role.ANALYST)
    page.locator('[data-shape="area"]').click()
    for east, north in ((4.0, 4.0), (9.0, 4.0), (9.0, -4.0)):
        page.mouse.click(*pixel_of(page, east, north, RESOLUTION))
        page.wait_for_timeout(350)  # else two clicks are a double-click
    page.mouse.dblclick(*pixel_of(page, 4.0, -4.0, RESOLUTION))
    page.locator("dialog select").select_option("keep-out")
    page.locator("dialog textarea").fill("loose sand")
    page.locator('dialog input[name="draft"]').check()
    page.locator('dialog button[type="submit"]').click()
    row = page.locator("[data-note]")
    row.wait_for()
    assert "Keep-out area, draft" in row.inner_text()
    ogc = f"{live}/ogc/MER2/collections/annotations/items?f=json"
    assert page.request.get(ogc).json()["features"] == []
    page.get_by_role("button", name="Edit", exact=True).click()
    page.locator("dialog textarea").fill("loose sand, 20 cm deep")
    page.locator('dialog input[name="draft"]').uncheck()
    page.locator('dialog button[type="submit"]').click()
    until(page, lambda: "20 cm deep" in row.inner_text() and "draft" not in row.inner_text())
    (feature,) = page.request.get(ogc).json()["features"]
    assert feature["geometry"]["type"] == "Polygon"
    assert feature["properties"]["category"] == "keep-out"
    row.get_by_text("History").click()
    changes = row.locator(".note-history li")
    until(page, lambda: changes.count() == 2)
    assert changes.first.inner_text().startswith("text: loose sand, 20 cm deep, published")
    assert changes.last.inner_text().startswith("written: loose sand")
    assert "UTC" in changes.last.inner_text()
    keep_screenshot(page, "history")
    page.get_by_role("button", name="Redraw").click()
    page.keyboard.press("Escape")
    assert len(EditLog.of(workspace.store.root).edits("MER2")) == 3


SLOW_FORM = """document.addEventListener("focusin", ({ target }) => {
  const until = performance.now() + 150;
  while (target.matches("dialog textarea") && performance.now() < until);
})"""


def test_a_drawn_point_is_not_identified_if_its_form_opens_slowly(page, workspace, live):
    look(page, live + at(RESOLUTION, "mer2/hillshade"))
    page.locator('[data-tab="notes"]').click()
    sign_in(page, workspace, Role.ANALYST)
    page.evaluate(SLOW_FORM)
    page.locator('[data-shape="point"]').click()
    page.mouse.click(*pixel_of(page, 6.0, -4.0, RESOLUTION))
    page.wait_for_timeout(300)  # a click is reported 250 ms later: it may be a double-click
    assert page.locator("dialog textarea").is_visible()
    assert page.locator("#panel-notes").is_visible()


def test_an_annotation_is_kept_while_the_server_is_away(page, workspace, live):
    look(page, live + at(RESOLUTION, "mer2/hillshade"))
    page.locator('[data-tab="notes"]').click()
    sign_in(page, workspace, Role.ANALYST)
    page.route("**/edits/annotations", lambda route: route.abort())
    page.locator('[data-shape="point"]').click()
    page.mouse.click(*pixel_of(page, 6.0, -4.0, RESOLUTION))
    page.locator("dialog textarea").fill("layered rock")
    page.locator('dialog button[type="submit"]').click()
    unsent = page.locator("[data-unsent]")
    unsent.wait_for()
    address = page.url
    page.goto("about:blank")  # the page is closed before the server is back
    page.unroute("**/edits/annotations")
    page.goto(address)
    ready(page)
    page.locator('[data-tab="notes"]').click()
    until(page, lambda: page.locator("[data-note]").count() == 1)
    assert unsent.count() == 0
    (edit,) = EditLog.of(workspace.store.root).edits("MER2")
    assert edit.document["text"] == "layered rock"


def test_a_key_opens_the_list_of_keys(page, live):
    look(page, live)
    page.keyboard.press("?")
    listed = page.locator("dialog kbd").all_inner_texts()
    assert {"?", "f", "n", "m", "Esc"} <= set(listed)
