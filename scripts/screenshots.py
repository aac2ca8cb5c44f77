"""Make the pictures of the README: `python scripts/screenshots.py` opens the demo in headless Chromium."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "docs"
CHROMIUM_ARGUMENTS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
SIZE = {"width": 1440, "height": 810}
SYNTHESIZED = (
    "test/000001/rgb/000002",
    "test/000002/rgb/000003",
    "test/000003/rgb/000007",
    "val_turntable/000001/rgb/000003",
)
"""Images of the demo that stand side by side."""
PICTURES = {
    "image": ("row=3,2,3,6,-1&follow=1", []),
    "scene": ("row=2,3,5,5,-1&view=scene&display.others=1", ["Curves"]),
    "leaderboard": ("board.open=1", []),
    "vsd": ("row=2,2,4,4,-1&follow=1&display.style=fill", ["VSD"]),
}
"""Name, what the address asks for, and the tab on the right."""


def _save_synthesized() -> None:
    """Put some images of the demo side by side."""
    images = [Image.open(ROOT / "assets" / "demo" / f"{name}.jpg").resize((400, 300)) for name in SYNTHESIZED]
    sheet = Image.new("RGB", (400 * len(images), 300))
    for k, image in enumerate(images):
        sheet.paste(image, (400 * k, 0))
    sheet.save(OUT / "synthesis.jpg", quality=88)


def main() -> None:
    """Start the server on the demo, take all pictures, and end it."""
    _save_synthesized()
    folder = tempfile.TemporaryDirectory()
    command = [sys.executable, "-m", "inspector", "serve", "--port", "0", "--no-browser", "--leaderboard", folder.name]
    server = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        address = next(word for word in server.stdout.readline().split() if word.startswith("http"))
        with sync_playwright() as playwright:
            chromium = shutil.which("chromium") or shutil.which("chromium-browser")
            browser = playwright.chromium.launch(executable_path=chromium, args=CHROMIUM_ARGUMENTS)
            for name, (query, tabs) in PICTURES.items():
                page = browser.new_page(viewport=SIZE)
                page.goto(f"{address}?{query}")
                _settle(page)
                if name == "leaderboard":
                    page.wait_for_function("() => document.querySelectorAll('.pi-number').length === 2", timeout=60_000)
                for tab in tabs:
                    page.get_by_role("tab", name=tab).click()
                _settle(page)
                _save(page, name)
                page.close()
            browser.close()
    finally:
        server.terminate()
        server.wait()
        folder.cleanup()


def _settle(page: Page) -> None:
    page.wait_for_selector(".pi-row[aria-selected=true]")
    page.wait_for_selector(".pi-legend-line:nth-child(2)")
    page.wait_for_function("() => document.querySelectorAll('.pi-job').length === 0")
    page.wait_for_function("() => !document.querySelector('.pi-overlay').classList.contains('pi-busy')")
    page.wait_for_timeout(2500)  # software WebGL draws slowly, and says nothing when it has


def _save(page: Page, name: str) -> None:
    shot = OUT / f"{name}.png"
    page.screenshot(path=shot)
    Image.open(shot).convert("RGB").save(OUT / f"{name}.jpg", quality=88)
    shot.unlink()


if __name__ == "__main__":
    main()
