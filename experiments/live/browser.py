"""Pages in headless Chromium, and phones that are emulated in them: for tests and pictures.

Needs Chromium (`tools/have.sh chromium`), playwright (in the test group), and the npm package iwer, a WebXR device
emulated in the page, which is fetched once into build/.
"""

from __future__ import annotations

import asyncio
import importlib.util
import json
import os
import shutil
import subprocess
import tarfile
import time
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.common.cpu import processes_below
from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.geometry import QUATERNION_Z_UP_FROM_Y_UP, Z_UP_FROM_Y_UP
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions

if TYPE_CHECKING:
    from playwright.async_api import Browser, BrowserContext, Page, Playwright

REPOSITORY = Path(__file__).parents[2]
IWER = "2.5.0"
PATIENCE_S = 90.0
"""s: for a page, on a busy machine."""
FLAGS = ["--no-sandbox", "--disable-features=WebRtcHideLocalIpsWithMdns", "--ignore-certificate-errors"]

# A phone whose pose is that of a table at the time of each frame: [t (s), x y z, qx qy qz qw], y up. Its loop is begun
# before the emulator's own, so that a frame sees the pose of its own stamp.
_PHONE = """
(() => {
  const config = {
    name: "phone", controllerConfig: undefined, supportedSessionModes: ["inline", "immersive-ar"],
    supportedFeatures: ["viewer", "local", "dom-overlay", "anchors"], supportedFrameRates: [60],
    isSystemKeyboardSupported: false, internalNominalFrameRate: 60,
    environmentBlendModes: { "immersive-ar": "alpha-blend" },
    interactionMode: "screen-space", userAgent: navigator.userAgent,
  };
  const options = { stereoEnabled: false, fovy: 1.1 };
  const probe = new IWER.XRDevice(config, options);
  probe.position.set(0, 0, 0);
  probe.quaternion.set(0, 0, 0, 1);
  options.headsetPosition = probe.position;
  options.headsetQuaternion = probe.quaternion;
  // The emulator lays its picture over everything; a phone lays the page's overlay over the camera's picture.
  options.canvasContainer = document.createElement("div");
  const device = new IWER.XRDevice(config, options);
  Object.assign(options.canvasContainer.style, { zIndex: 0, pointerEvents: "none" });
  options.canvasContainer.style.background = "linear-gradient(#c9cfd6 0 55%, #8d8678 55%)";
  device.installRuntime({ forceInstall: true });
  const phone = (globalThis.phone = { device, table: null, began: 0, place });
  function place(t) {
    const { table } = phone;
    let i = table.findIndex((row) => row[0] > t);
    i = i < 0 ? table.length - 1 : Math.max(1, i);
    const [a, b] = [table[i - 1], table[i]];
    const share = Math.min(1, Math.max(0, (t - a[0]) / (b[0] - a[0])));
    const sign = a[4] * b[4] + a[5] * b[5] + a[6] * b[6] + a[7] * b[7] < 0 ? -1 : 1;
    const mixed = a.map((v, k) => v + share * ((k < 4 ? 1 : sign) * b[k] - v));
    const length = Math.hypot(...mixed.slice(4));
    return [...mixed.slice(1, 4), ...mixed.slice(4).map((v) => v / length)];
  }
  requestAnimationFrame(function each() {
    requestAnimationFrame(each);
    if (!phone.table) return;
    // Not the frame's own time: the emulator stamps its frames when they are called.
    const now = (performance.timeOrigin + performance.now()) / 1000;
    const [x, y, z, qx, qy, qz, qw] = phone.place(now - phone.began);
    // A hand trembles: poses that repeat to the last bit are those of a SLAM that has stopped.
    const tremor = [1.3, 1.7, 2.3].map((hertz) => 0.0005 * Math.sin(2 * Math.PI * hertz * now));
    device.position.set(x + tremor[0], y + tremor[1], z + tremor[2]);
    device.quaternion.set(qx, qy, qz, qw);
  });
})();
"""


def why_not() -> str | None:
    """Why no browser can be had here, in a sentence; None: it can."""
    if chromium() is None:
        return "needs chromium, which is not here (tools/have.sh chromium)"
    if importlib.util.find_spec("playwright") is None:
        return "needs playwright, which is not here (pip install --group test)"
    try:
        iwer()
    except (OSError, subprocess.SubprocessError):
        return f"needs the npm package iwer {IWER}, which could not be fetched"
    return None


def chromium() -> str | None:
    """Where Chromium is."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def iwer() -> str:
    """The script that emulates a WebXR device, fetched once. Raises OSError or SubprocessError where it cannot be."""
    script = REPOSITORY / "build" / "iwer" / f"iwer-{IWER}.min.js"
    if not script.is_file():
        script.parent.mkdir(parents=True, exist_ok=True)
        # Another process may fetch it at the same time: it is there as a whole or not at all.
        with TemporaryDirectory(dir=script.parent) as folder:
            run = ["npm", "pack", f"iwer@{IWER}", "--silent", "--pack-destination", folder]
            subprocess.run(run, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=120)
            with tarfile.open(Path(folder, f"iwer-{IWER}.tgz")) as package:
                content = package.extractfile("package/build/iwer.min.js")
                assert content is not None
                Path(folder, script.name).write_bytes(content.read())
            Path(folder, script.name).replace(script)
    return script.read_text()


async def launch(playwright: Playwright) -> Browser:
    """Headless Chromium."""
    return await playwright.chromium.launch(executable_path=chromium(), args=FLAGS, timeout=1000.0 * PATIENCE_S)


async def context(browser: Browser, width: int, height: int, dark: bool = False, phone: bool = False) -> BrowserContext:
    """A profile of its own, as each device needs: the hidden pages of one profile hardly run. `phone`: emulates one."""
    made = await browser.new_context(
        viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light", ignore_https_errors=True
    )
    made.set_default_timeout(1000.0 * PATIENCE_S)
    if phone:
        await made.add_init_script(iwer() + _PHONE)
    return made


def complaints(page: Page) -> list[str]:
    """What the page complains of from now on: errors, warnings, what its policy forbids."""
    heard: list[str] = []
    page.on("pageerror", lambda error: heard.append(str(error)))
    page.on("console", lambda said: heard.append(said.text) if said.type in ("error", "warning") else None)
    return heard


async def walk_in(page: Page, url: str, code: str, name: str, track: Track, began: float) -> None:
    """As a person does it: from the join page to AR, the phone being where the track says."""
    await arrive(page, url, code, name)
    await start(page, track, began)


async def arrive(page: Page, url: str, code: str, name: str) -> None:
    """From the join page to the phone's page."""
    await page.goto(f"{url}/#{code}")
    await page.fill("#code", code)
    await page.fill("#name", name)
    await page.click("#walk")
    await page.wait_for_url("**/phone*")


async def start(page: Page, track: Track, began: float) -> None:
    """From the phone's page to AR, the phone being where the track says."""
    await move(page, track, began)
    await page.click("#enter")
    await page.wait_for_selector("#overlay:not([hidden])")
    hurry()


def hurry() -> None:
    """Let Chromium be as urgent as this process: it gives its own processes the urgency that it likes."""
    own = os.getpriority(os.PRIO_PROCESS, 0)
    if own >= 0:
        return
    for process in processes_below(os.getpid()):
        with suppress(OSError):
            if b"--type=" in Path(f"/proc/{process}/cmdline").read_bytes():
                for thread in Path(f"/proc/{process}/task").iterdir():
                    os.setpriority(os.PRIO_PROCESS, int(thread.name), own)


async def move(page: Page, track: Track, began: float) -> None:
    """Let the phone follow a track in axes with z up, whose t = 0 is at `began` (s since 1970)."""
    await page.evaluate("([table, began]) => Object.assign(phone, {table, began})", [table(track).tolist(), began])


def table(track: Track) -> Array:
    """(n, 8): t, position, attitude of a phone, y up, on a track in axes with z up whose body looks along x."""
    # The body of a phone looks along its own -z, with y up.
    quat = multiply_quaternions(track.quat_xyzw, QUATERNION_Z_UP_FROM_Y_UP)
    quat = multiply_quaternions(inverse_quaternions(QUATERNION_Z_UP_FROM_Y_UP), quat)
    return np.column_stack([track.t, track.position @ Z_UP_FROM_Y_UP, quat])


async def told(page: Page, expression: str) -> Any:
    """What an expression is in the page, as JSON."""
    return json.loads(await page.evaluate(f"JSON.stringify({expression})"))


async def until(page: Page, expression: str, seconds: float = PATIENCE_S) -> None:
    """Until an expression is true in the page. Raises TimeoutError where it does not become so.

    Playwright's own way evaluates strings within the page, which the pages' policy forbids.
    """
    end = time.monotonic() + seconds
    while not await page.evaluate(f"Boolean({expression})"):
        if time.monotonic() > end:
            raise TimeoutError(f"not within {seconds:.0f} s: {expression}")
        await asyncio.sleep(0.1)
