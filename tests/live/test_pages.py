"""The pages in a browser, with a server and native devices: a page that looks, and one that walks with a phone."""

from __future__ import annotations

import asyncio
import importlib.util
import time
from typing import Any

import numpy as np
import pytest

from experiments.live import browser
from experiments.live.walkers import server, walk
from synchronizar.arrays import Array
from synchronizar.geometry import Z_UP_FROM_Y_UP, YawFrame
from synchronizar.live.client import Client
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

HOSTILE = "<img src=x onerror=alert(1)>"
PHONE, NATIVE = "phone1", ("phone0", "phone2")
# Where each of the others is drawn, in the phone's own frame, whenever something new is drawn.
LOG = """() => {
  const { avatars, frame, stage } = synchronizar;
  globalThis.drawn = [];
  const seen = {};
  setInterval(() => {
    const m = stage.common.matrix.elements;
    for (const [name, { t, position: [x, y, z] }] of Object.entries(avatars.places)) {
      if (!frame.registered || frame.opacity < 1 || seen[name] === t) continue;
      seen[name] = t;
      const place = [0, 1, 2].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]);
      drawn.push([name, t, frame.told.sigma, ...place]);
    }
  }, 50);
}"""

# A hand that is `aside` (m) of where the only object is shown, and closes or opens there.
HAND = """([kind, aside]) => {
  const { client, stage } = synchronizar;
  const [{ position: [x, y, z] }] = client.objects.values();
  const m = stage.common.matrix.elements;
  const [a, b, c] = [0, 1, 2].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]);
  const local = stage.renderer.xr.getReferenceSpace();
  const session = stage.renderer.xr.getSession();
  globalThis.hand ??= {};
  session.requestAnimationFrame(async (_, frame) => {
    // The emulator's own offset spaces are wrong; an anchor's is right.
    const there = await frame.createAnchor(new XRRigidTransform({ x: a + aside, y: b, z: c }), local);
    hand.targetRaySpace = there.anchorSpace;
    const say = (_, frame) => session.dispatchEvent(Object.assign(new Event(kind), { frame, inputSource: hand }));
    if (kind) session.requestAnimationFrame(say);
  });
}"""
HELD = f"[...synchronizar.client.objects.values()].find(({{ holder }}) => holder === '{PHONE}')"

# Who is in the table of devices, as text: three that are in place, and a stranger.
DEVICES = "document.getElementById('devices').innerText"
ALL_SHOWN = f"(text => text.includes('{HOSTILE}') && text.split('in place').length === 4)({DEVICES})"

# However slow the machine is: as much as is judged.
ENOUGH = "drawn.length > 60 && new Set(drawn.map(([name]) => name)).size === 2"


def sigmas_off(simulation: Simulation, drawn: list[list[Any]], began: float) -> Array:
    """(n,): how far from the truth each place was drawn, in the sigmas that were told of the phone's own."""
    own_from_world = own_frame(simulation).inverse()
    out = []
    for name, t, sigma, *place in drawn:
        truth = simulation.truth[name]
        true = [np.interp(t - began, truth.t, axis) for axis in truth.position.T]
        off = Z_UP_FROM_Y_UP @ np.array(place) - own_from_world.apply(np.array(true))
        out.append(np.linalg.norm(off) / sigma)
    return np.array(out)


def own_frame(simulation: Simulation) -> YawFrame:
    """The phone's own frame in the room's: its SLAM does not drift."""
    return simulation.world_from_user[PHONE]


@pytest.fixture(autouse=True)
def _chromium() -> None:
    if reason := browser.why_not():
        pytest.skip(reason)


async def registered(page: Any) -> None:
    try:
        await browser.until(page, "synchronizar.frame?.registered && synchronizar.frame.opacity === 1")
    except TimeoutError:
        known = await browser.told(page, "[synchronizar.client.frames, synchronizar.client.status]")
        raise AssertionError(f"the phone is not registered: {known}") from None


async def take_and_put_down(phone: Any) -> list[dict[str, Any]]:
    """The marker as it stood, as it was carried half a metre, and as it was left."""
    marker = "[...synchronizar.client.objects.values()][0]"
    await browser.until(phone, "synchronizar.anchors.count > 0")
    stages = [await browser.told(phone, marker)]
    assert all(map(np.isfinite, await browser.told(phone, f"synchronizar.anchors.at({marker}.id)")))
    await browser.until(phone, "synchronizar.frame.registered")
    await phone.evaluate(HAND, ["squeezestart", 0.0])
    await browser.until(phone, f"{HELD}?.velocity")
    await phone.evaluate(HAND, ["", 0.5])
    x, y, _ = stages[0]["position"]
    await browser.until(phone, f"Math.hypot({HELD}.position[0] - {x}, {HELD}.position[1] - {y}) > 0.3")
    stages.append(await browser.told(phone, HELD))
    await phone.evaluate(HAND, ["squeezeend", 0.0])
    await browser.until(phone, f"!{HELD}")
    return [*stages, await browser.told(phone, marker)]


async def visit(simulation: Simulation, where: dict[str, Any]) -> dict[str, Any]:
    from playwright.async_api import async_playwright

    out: dict[str, Any] = {}
    async with async_playwright() as playwright:
        chromium = await browser.launch(playwright)
        phone = await (await browser.context(chromium, 240, 320, phone=True)).new_page()
        room = await (await browser.context(chromium, 800, 600)).new_page()
        complaints = browser.complaints(phone), browser.complaints(room)
        await room.goto(f"{where['url']}/room#{where['room']}")
        client = await Client.join(where["join"], NATIVE)
        out["began"] = began = time.time() + 0.5
        walking = asyncio.create_task(walk(client, simulation.recording, NATIVE, began))
        # The reference is whoever walks first.
        await asyncio.sleep(3.0)
        track = simulation.recording.tracks[PHONE]
        await browser.walk_in(phone, where["url"], where["room"], PHONE, track, began)
        await browser.until(phone, "synchronizar.stage.renderer.xr.isPresenting")
        # Before anybody knows where it is: the room keeps the marker until it does.
        await phone.click("#mark")
        await phone.evaluate(LOG)
        await registered(phone)
        await browser.until(room, "document.getElementById('count-registered').textContent === '3 of 3'")
        await browser.until(phone, ENOUGH)
        out["drawn"] = await browser.told(phone, "drawn")
        out["objects"] = await browser.told(phone, "[...synchronizar.client.objects.values()]")
        out["transport"] = await browser.told(phone, "synchronizar.client.transport")
        out["shown"] = await browser.told(phone, "[synchronizar.objects.ids, synchronizar.objects.waiting]")
        out["held"] = await take_and_put_down(phone)
        stranger = await Client.join(where["join"], [HOSTILE])
        await browser.until(room, ALL_SHOWN)
        out["looked"] = await room.inner_text("#devices")
        out["pictures"] = await room.locator("#devices img, table img, #events img").count()
        await stranger.leave()
        # A reload: the same device, in another frame, found anew.
        await phone.reload()
        await browser.start(phone, track, began)
        await phone.evaluate(LOG)
        await registered(phone)
        await browser.until(phone, ENOUGH)
        out["again"] = await browser.told(phone, "drawn")
        out["member"] = await browser.told(phone, f"synchronizar.client.member('{PHONE}')")
        # Who leaves may come again.
        await phone.click("#leave")
        await phone.wait_for_selector("#enter:enabled")
        await browser.start(phone, track, began)
        await browser.until(phone, "synchronizar.client.state === 'open'")
        out["left"] = await browser.told(phone, f"synchronizar.client.member('{PHONE}').here")
        walking.cancel()
        await client.close()
        out["complaints"] = [line for heard in complaints for line in heard if "GL Driver" not in line]
        await chromium.close()
    return out


def test_a_page_that_walks_sees_the_others_where_they_are_and_one_that_looks_sees_all() -> None:
    simulation = simulate(Scene(users=3, seconds=240.0, seed=5))
    with server() as where:
        out = asyncio.run(visit(simulation, where))
    assert out["complaints"] == []
    assert out["transport"] == ("webtransport" if importlib.util.find_spec("aioquic") else "websocket")
    # Names are text, whatever they are.
    assert HOSTILE in out["looked"]
    assert out["pictures"] == 0
    assert out["looked"].count("in place") == 3
    for drawn in (out["drawn"], out["again"]):
        assert {name for name, *_ in drawn} == set(NATIVE)
        assert np.percentile(sigmas_off(simulation, drawn, out["began"]), 95) < 2.5
    marker = out["objects"][0]
    assert (marker["kind"], marker["by"], len(out["objects"])) == ("marker", PHONE, 1)
    qx, qy, _, _ = marker["quat_xyzw"]
    assert abs(qx) + abs(qy) < 0.01  # upright
    assert out["shown"] == [[marker["id"]], 0]
    stood, carried, left = out["held"]
    assert stood["holder"] is left["holder"] is left["velocity"] is None
    assert carried["holder"] == PHONE
    assert np.linalg.norm(np.subtract(left["position"], stood["position"])) > 0.3
    assert out["member"]["frame"] == 1
    assert out["left"]


async def look_without_ar(where: dict[str, Any]) -> dict[str, Any]:
    from playwright.async_api import async_playwright

    out: dict[str, Any] = {}
    async with async_playwright() as playwright:
        chromium = await browser.launch(playwright)
        page = await (await browser.context(chromium, 390, 700)).new_page()
        complaints = browser.complaints(page)
        await page.goto(where["join"])
        await browser.until(page, "document.getElementById('ability').textContent")
        out["walk"] = await page.is_disabled("#walk")
        out["why"] = await page.inner_text("#ability")
        await page.fill("#code", "WRONGCODE")
        await page.press("#code", "Tab")
        await page.click("#look")
        await browser.until(page, "document.getElementById('banner').dataset.kind === 'error'")
        out["wrong"] = await page.inner_text("#banner")
        out["focus"] = await page.evaluate("document.activeElement.id")
        complaints.clear()  # the answer 404 is one
        await page.fill("#code", where["room"].lower())
        await page.click("#look")
        await page.wait_for_url("**/room*")
        await browser.until(page, "globalThis.synchronizar?.client.state === 'open'")
        await page.wait_for_selector("#qr:not([hidden])")
        out["qr"] = await page.get_attribute("#qr", "alt")
        # Who follows a link to the phone's page lands here, and is told why.
        await page.evaluate(
            "code => sessionStorage.setItem('synchronizar', JSON.stringify({code, name: 'ann'}))", where["room"]
        )
        await page.goto(f"{where['url']}/phone#{where['room']}")
        await page.wait_for_url("**/room*")
        await browser.until(page, "document.getElementById('banner').dataset.kind === 'note'")
        out["note"] = await page.inner_text("#banner p")
        out["complaints"] = complaints
        await chromium.close()
    return out


def test_a_browser_without_ar_looks_and_says_why_and_a_wrong_code_is_told_with_a_way_on() -> None:
    with server() as where:
        out = asyncio.run(look_without_ar(where))
    assert out["walk"]
    assert out["why"] == "This device cannot show AR. You can look all the same."
    assert out["wrong"] == "There is no room with that code: look at the room's page for it."
    assert out["focus"] == "code"
    assert out["qr"].startswith("QR code of https://")
    assert out["note"] == "This device cannot show AR. So you are looking."
    assert out["complaints"] == []
