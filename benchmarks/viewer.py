"""What a person waits for: the real command and real Chromium, on the demo, on LM-O and on 2,000 targets.

    python benchmarks/viewer.py [--quick] [--data DIR]    (DIR: folder of LM-O in BOP format; default ../shared/data/lmo)

Nothing is asserted. Aims: 3 s from the command to the first usable page, 300 ms of server time for a click, 1.5 GiB with
2,000 targets. References measured in this same run: a bare viser server with one button and its page, and the picture
that a throw-away script makes of a target. Server time is what the session logs (`INSPECTOR_LOG=debug`): from the
selection to the last panel filled. "page" is the time in the browser from the click to the new legend, which is
published after the picture was sent; what WebGL then draws is not in it. Chromium draws in software on the same cores.
"""

import itertools
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import cv2
import msgspec
import numpy as np
import tyro
import viser
import zstandard
from playwright.sync_api import Browser, Page, sync_playwright
from rich.console import Console
from rich.table import Table
from websockets import Origin, Subprotocol
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.results import Results, read_results, write_results
from pipeline.scene import ImageKey

ROOT = Path(__file__).resolve().parent.parent
LMO = Path(os.environ.get("INSPECTOR_SHARED_DATA", ROOT.parent / "shared" / "data")) / "lmo"
DEMO = ROOT / "assets" / "demo"
CHROMIUM = (
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
TARGETS, CLICKS_ON_TARGETS, BROWSERS, CLICKS_PER_BROWSER = 2000, 50, 5, 10
STALLING_CLICKS = 50
"""Some 5 MB, more than the kernel keeps for a connection."""
PATIENCE_S = 90.0
BARE_VISER = """
import viser
server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
server.on_client_connect(lambda client: client.gui.add_button("usable"))
print(f"http://127.0.0.1:{server.get_port()}/", flush=True)
server.sleep_forever()
"""

# Until the picture of the selected row is there; then, until the panels are filled too.
READY = """() => document.querySelector(".pi-row") && document.querySelector(".pi-legend-line + .pi-legend-line")
    && !document.querySelector(".pi-overlay").classList.contains("pi-busy")"""
SETTLE = """async () => {
    const busy = () => document.querySelector(".pi-job, .pi-busy") !== null;
    const begun = performance.now();
    for (let since = begun; performance.now() - since < 700; ) {
        await new Promise((resolve) => setTimeout(resolve, 50));
        if (busy()) since = performance.now();
        if (performance.now() - begun > 120000) throw new Error("still at work after two minutes");
    }
}"""
CLICK = """async (position) => {
    const find = (selector) => document.querySelector(selector);
    const until = (condition) => new Promise((resolve, reject) => {
        const observer = new MutationObserver(() => look());
        const stop = (end, value) => { observer.disconnect(); clearTimeout(timer); end(value); };
        const timer = setTimeout(() => stop(reject, new Error(`no picture of row ${position}`)), 30000);
        const look = () => { if (condition()) stop(resolve, performance.now()); };
        observer.observe(find(".pi-overlay"), { subtree: true, childList: true, attributes: true });
        observer.observe(find("#pi-targets"), { subtree: true, childList: true });
        look();
    });
    find(".pi-body").scrollTop = Math.max(0, position * 26 - 100);
    const row = () => find(`.pi-row[data-position="${position}"]`);
    await until(row);
    const before = location.search;
    const begun = performance.now();
    row().click();
    const seen = await until(() => location.search !== before);
    const done = await until(() => !find(".pi-overlay").classList.contains("pi-busy"));
    return [seen - begun, done - begun];
}"""
CLICK_ALL = f"""(positions) => {{
    window.clicked = (async () => {{
        const times = [];
        for (const position of positions) times.push(await ({CLICK})(position));
        return times;
    }})();
    window.clicked.catch(() => null);
}}"""


class Source(NamedTuple):
    """A dataset with one results file."""

    root: Path
    results: Path

    @property
    def arguments(self) -> tuple[str, ...]:
        """What `inspector serve` is given."""
        return str(self.root), "--results", str(self.results)


class Click(NamedTuple):
    """Milliseconds from a click to the new legend, and to the end of the work for it."""

    seen: float
    done: float


@dataclass
class Server:
    """A running command that printed its URL."""

    process: subprocess.Popen
    url: str
    begun: float
    seconds_to_url: float
    shown_ms: list[float] = field(default_factory=list)
    """What the sessions logged, in order."""

    def cpu_seconds(self) -> float:
        """Processor time used so far."""
        # Fields are counted behind the name, which may hold blanks: utime and stime are the 14th and 15th of all.
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def memory(self) -> tuple[float, float]:
        """Resident memory now and at its peak, GiB."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        kilobytes = dict(re.findall(r"(\w+):\s+(\d+) kB", status))
        return int(kilobytes["VmRSS"]) / 2**20, int(kilobytes["VmHWM"]) / 2**20

    def read_log(self) -> None:
        """Collect the times that sessions log; runs until the process ends."""
        assert self.process.stderr is not None
        for line in self.process.stderr:
            if (found := re.search(r"inspector\.session: shown in (\d+) ms", line)) is not None:
                self.shown_ms.append(float(found[1]))


@contextmanager
def running(*command: str) -> Iterator[Server]:
    """Start a Python command that prints a URL; end it afterwards."""
    begun = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, *command],
        cwd=ROOT,
        env=os.environ | {"INSPECTOR_LOG": "debug", "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        url = next((found[0] for line in process.stdout if (found := re.search(r"http://\S+", line))), None)
        if url is None:
            raise SystemExit(f"{' '.join(command)} ended: {process.stderr.read() if process.stderr else ''}")
        server = Server(process, url, begun, time.perf_counter() - begun)
        threading.Thread(target=server.read_log, daemon=True).start()
        yield server
    finally:
        process.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            process.wait(5)
        process.kill()


def inspecting(source: Source) -> AbstractContextManager[Server]:
    """Start the real command on a dataset."""
    return running("-m", "inspector", "serve", *source.arguments, "--port", "0", "--no-browser")


@contextmanager
def page_of(browser: Browser) -> Iterator[Page]:
    """A page in a context of its own, as another person's browser would be."""
    context = browser.new_context(viewport={"width": 1400, "height": 900})
    page = context.new_page()
    page.set_default_timeout(PATIENCE_S * 1000)
    try:
        yield page
    finally:
        context.close()


# ---- starting


class Start(NamedTuple):
    """Seconds from the command to the URL, and to the first usable page."""

    url: float
    usable: float


def start_inspector(browser: Browser, source: Source) -> Start:
    """Start, open, and wait for the table and the picture of its first row."""
    with inspecting(source) as server, page_of(browser) as page:
        page.goto(server.url)
        page.wait_for_function(READY, polling="raf")
        return Start(server.seconds_to_url, time.perf_counter() - server.begun)


def start_bare(browser: Browser) -> Start:
    """The same for viser with nothing but a button."""
    with running("-c", BARE_VISER) as server, page_of(browser) as page:
        page.goto(server.url)
        page.get_by_text("usable", exact=True).wait_for()
        page.locator("canvas[data-engine]").wait_for()
        return Start(server.seconds_to_url, time.perf_counter() - server.begun)


def measure_starts(browser: Browser, sources: list[Source], repeats: int) -> Table:
    """Both in turn, so that what else the machine does hits both alike."""
    ours: dict[Source, list[Start]] = {source: [] for source in sources}
    bare = []
    for _ in range(repeats):
        bare.append(start_bare(browser))
        for source in sources:
            ours[source].append(start_inspector(browser, source))
    table = Table("from the command, s", "to the URL", "to a usable page", "worst", "times bare viser")
    reference = np.median(bare, axis=0)
    for name, starts in [("bare viser", bare), *((f"inspector, {s.root.name}", times) for s, times in ours.items())]:
        url, usable = np.median(starts, axis=0)
        worst = max(start.usable for start in starts)
        table.add_row(name, f"{url:.2f}", f"{usable:.2f}", f"{worst:.2f}", f"{usable / reference[1]:.2f}")
    return table


# ---- clicking


def click_through(page: Page, positions: list[int]) -> list[Click]:
    """Click rows of the table one after the other."""
    return [Click(*page.evaluate(CLICK, position)) for position in positions]


def spread(rows: int, count: int) -> list[int]:
    """Positions all over the table, never the first, which is selected already."""
    return np.linspace(1, rows - 1, min(count, rows - 1)).astype(int).tolist()


def rows_of(page: Page) -> int:
    """Length of the table."""
    return round(page.evaluate("() => document.querySelector('.pi-spacer').clientHeight / 26"))


def settle(page: Page) -> None:
    """Wait until all assessments are finished: nothing has been going on for a while."""
    page.evaluate(SETTLE)


class Clicks(NamedTuple):
    """What clicks cost."""

    server_ms: list[float]
    page: list[Click]
    cpu_ms: float
    """Processor time of the server for each click."""

    def cells(self, name: str, reference: float | None = None) -> list[str]:
        """A row of the table."""
        seen = [click.seen for click in self.page]
        ratio = "" if reference is None else f"{np.median(self.server_ms) / reference:.2f}"
        numbers = (*_median_and_worst(self.server_ms), self.cpu_ms, *_median_and_worst(seen))
        return [name, str(len(self.page)), *(f"{number:.0f}" for number in numbers), ratio]


def _median_and_worst(values: list[float]) -> tuple[float, float]:
    return float(np.median(values)), max(values)


def clicks_table(reference: str) -> Table:
    """The columns of `Clicks.cells`."""
    return Table("clicks, ms", "clicks", "server", "worst", "CPU", "page", "worst", f"server, times {reference}")


def pooled(parts: list[Clicks]) -> Clicks:
    """Several rounds as one."""
    server_ms = [ms for part in parts for ms in part.server_ms]
    clicks = [click for part in parts for click in part.page]
    return Clicks(server_ms, clicks, float(np.mean([part.cpu_ms for part in parts])))


def measured(server: Server, pages: list[Page], positions: list[int]) -> Clicks:
    """Click through rows in all pages at once, each page beginning elsewhere."""
    already, cpu = len(server.shown_ms), server.cpu_seconds()
    for number, page in enumerate(pages):
        shift = number * len(positions) // len(pages)
        page.evaluate(CLICK_ALL, positions[shift:] + positions[:shift])
    clicks = [Click(*times) for page in pages for times in page.evaluate("() => window.clicked")]
    cpu = server.cpu_seconds() - cpu
    time.sleep(0.2)  # until the last line of the log has come through the pipe
    return Clicks(server.shown_ms[already:], clicks, 1000 * cpu / len(clicks))


def measure_clicks(browser: Browser, source: Source, count: int, table: Table, rounds: int = 5) -> None:
    """Clicks all over the table, in turn with the same number of pictures made by a throw-away script."""
    draw = throw_away_script(source)
    with inspecting(source) as server, page_of(browser) as page:
        page.goto(server.url)
        page.wait_for_function(READY)
        settle(page)
        positions = spread(rows_of(page), count)
        clicks, script_ms = [], []
        for first in range(rounds):
            clicks.append(measured(server, [page], positions[first::rounds]))
            script_ms += [draw() for _ in positions[first::rounds]]
    reference = float(np.median(script_ms))
    table.add_row(*pooled(clicks).cells(source.root.name, reference))
    table.add_row(
        f"  a script's picture of {source.root.name}", str(len(script_ms)), f"{reference:.0f}", f"{max(script_ms):.0f}"
    )


def throw_away_script(source: Source) -> Callable[[], float]:
    """Return what makes the picture of one target after the other (image, two outlines, a file) and says the milliseconds."""
    dataset, results = open_dataset(source.root), read_results(source.results)
    found = dataset.targets()
    targets = itertools.cycle(found[i] for i in np.random.default_rng(0).permutation(len(found)))

    def draw() -> float:
        target = next(targets)
        begun = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            draw_with_script(dataset, results, target.image, target.obj_id, Path(folder) / "target.png")
        return 1000 * (time.perf_counter() - begun)

    for _ in range(10):  # libraries and models are loaded
        draw()
    return draw


def draw_with_script(dataset: Dataset, results: Results, key: ImageKey, obj_id: int, path: Path) -> None:
    """Models stay loaded, the rest is done anew, with whole images cast."""
    import open3d as o3d

    tensor = o3d.core.Tensor.from_numpy
    model, camera = dataset.model(obj_id), dataset.camera(key)
    picture = cv2.imread(str(dataset.rgb_path(key)))
    assert picture is not None
    truths = [gt.camera_from_model for gt in dataset.ground_truth(key) if gt.obj_id == obj_id][:1]
    estimates = [estimate.camera_from_model for estimate in results.estimates(key, obj_id)][:1]
    for pose, color in [*((pose, (0, 255, 0)) for pose in truths), *((pose, (255, 0, 0)) for pose in estimates)]:
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(tensor(model.vertices.astype(np.float32)), tensor(model.faces.astype(np.uint32)))
        rays = scene.create_rays_pinhole(tensor(camera.K), tensor(pose), camera.width, camera.height)
        mask = np.isfinite(scene.cast_rays(rays)["t_hit"].numpy()).astype(np.uint8)
        outline, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, list(outline), -1, color)
    cv2.imwrite(str(path), picture)


# ---- many targets


def repeated(source: Source, folder: Path, targets: int) -> Source:
    """The dataset again and again under new scene ids, by symbolic links, until it has so many targets."""
    dataset, results = open_dataset(source.root), read_results(source.results)
    copies = -(-targets // sum(target.inst_count for target in dataset.targets()))
    root = folder / f"{source.root.name}_{targets}"
    split = root / dataset.split
    split.mkdir(parents=True)
    for entry in source.root.iterdir():
        if entry.name.startswith(("models", "camera")):
            (root / entry.name).symlink_to(entry.resolve())
    step = max(dataset.scene_ids) + 1
    for copy in range(copies):
        for scene_id in dataset.scene_ids:
            target = (source.root / dataset.split / f"{scene_id:06d}").resolve()
            (split / f"{copy * step + scene_id:06d}").symlink_to(target)
    many = Results(
        scene_id=np.concatenate([results.scene_id + copy * step for copy in range(copies)]),
        im_id=np.tile(results.im_id, copies),
        obj_id=np.tile(results.obj_id, copies),
        score=np.tile(results.score, copies),
        rotation=np.tile(results.rotation, (copies, 1, 1)),
        translation_mm=np.tile(results.translation_mm, (copies, 1)),
        time_s=np.tile(results.time_s, copies),
    )
    path = folder / f"many_{root.name}-test.csv"
    write_results(path, many)
    return Source(root, path)


def measure_many(browser: Browser, source: Source, clicks: int, table: Table) -> list[str]:
    """Open a large dataset, click while it is being assessed and afterwards; memory before and after."""
    with inspecting(source) as server, page_of(browser) as page:
        page.goto(server.url)
        page.wait_for_function(READY, polling="raf")
        usable = time.perf_counter() - server.begun
        at_first = rows_of(page)
        working = page.evaluate("() => document.querySelector('.pi-progress').textContent")
        during = click_through(page, spread(at_first, 6))
        still = page.evaluate("() => document.querySelector('.pi-job') !== null")
        settle(page)
        assessed = time.perf_counter() - server.begun
        opened = server.memory()
        rows = rows_of(page)
        after = measured(server, [page], spread(rows, clicks))
        used = server.memory()
        table.add_row(*after.cells(f"{rows} targets"))
    seen = [click.seen for click in during]
    return [
        f"{rows} targets: usable after {usable:.1f} s with {at_first} of them (at work: {working or 'no'}), all done after {assessed:.1f} s",
        f"  {len(during)} clicks {'during' if still else 'partly after'} assessment: {np.median(seen):.0f} ms to the legend, worst {max(seen):.0f}",
        f"  memory: {opened[0]:.2f} GiB when assessed, {used[0]:.2f} after {clicks} clicks, {used[1]:.2f} at the peak",
    ]


# ---- many browsers


@contextmanager
def stalled_browser(url: str, rows: int) -> Iterator[None]:
    """A browser that was sent more than all buffers hold, reads none of it, and stays connected."""
    camera = {
        "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 0.0), "fov": 1.0,
        "near": 0.1, "far": 10.0, "image_height": 900, "image_width": 1400, "look_at": (0.0, 0.0, 1.0),
        "up_direction": (0.0, -1.0, 0.0),
    }  # fmt: skip
    with connect(
        url.replace("http", "ws", 1),
        origin=Origin(url.rstrip("/")),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        compression=None,
        max_size=None,
        max_queue=1,
        ping_interval=None,
        close_timeout=0.1,
    ) as connection:
        connection.send(msgspec.msgpack.encode(camera))
        key = _session_key(connection)
        for click in range(STALLING_CLICKS):
            query = urllib.parse.urlencode({"key": key, "method": "select", "args": f"[{click % rows}]"})
            urllib.request.urlopen(f"{url}inspector/call?{query}", timeout=10).close()
            time.sleep(0.1)  # else only the last of them would be drawn
        yield


def _session_key(connection: Connection) -> str:
    """Read on until the server has named the session."""
    while True:
        packet = connection.recv(timeout=30)
        assert isinstance(packet, bytes)
        packed = int.from_bytes(packet[8:16], "little")
        messages = zstandard.ZstdDecompressor().decompress(packet[16 : 16 + packed])
        if (found := re.search(rb'data-key=\\?"([\w-]+)', messages)) is not None:
            return found[1].decode()


def measure_browsers(browser: Browser, source: Source, table: Table, clicks: int, repeats: int) -> None:
    """One browser, in turn alone and beside a stalled one, so that what else the machine does hits both; five at once."""
    with inspecting(source) as server, ExitStack() as open_pages:
        pages = [open_pages.enter_context(page_of(browser)) for _ in range(BROWSERS)]
        pages[0].goto(server.url)
        pages[0].wait_for_function(READY)
        settle(pages[0])
        rows = rows_of(pages[0])
        positions = spread(rows, clicks)
        measured(server, pages[:1], positions)  # models are read, and what is kept of them is made
        alone, beside = [], []
        for _ in range(repeats):
            alone.append(measured(server, pages[:1], positions))
            with stalled_browser(server.url, rows):
                time.sleep(1)  # until what was asked for last is drawn
                beside.append(measured(server, pages[:1], positions))
        reference = float(np.median(pooled(alone).server_ms))
        table.add_row(*pooled(alone).cells("1 browser", reference))
        table.add_row(*pooled(beside).cells("1 beside a stalled one", reference))
        for page in pages[1:]:
            page.goto(server.url)
        for page in pages:
            page.wait_for_function(READY)
            settle(page)
        at_once = measured(server, pages, positions)
        table.add_row(*at_once.cells(f"{BROWSERS} at once", reference))


def load() -> str:
    """What else the machine does."""
    return f"load {', '.join(f'{value:.1f}' for value in os.getloadavg())} on {os.cpu_count()} cores"


def main(quick: bool = False, data: Path = LMO) -> None:
    """Measure and print.

    Args:
        quick: Fewer repetitions.
        data: LM-O with results; left out where it is absent.

    """
    console = Console(width=120)
    sources = [
        Source(root, results)
        for root in (DEMO, data)
        if root.is_dir() and (results := next(iter(sorted((root / "results").glob("*.csv"))), None)) is not None
    ]
    executable = shutil.which("chromium") or "/usr/bin/chromium"
    console.print(load())
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=executable, args=list(CHROMIUM))
        console.print(measure_starts(browser, sources, repeats=1 if quick else 3))
        clicks = clicks_table("the script")
        for source in sources:
            measure_clicks(browser, source, 10 if quick else 30, clicks)
        many = repeated(sources[0], Path(folder), TARGETS)
        lines = measure_many(browser, many, 10 if quick else CLICKS_ON_TARGETS, clicks)
        console.print(clicks, *lines, sep="\n")
        browsers = clicks_table("1 browser")
        measure_browsers(browser, sources[0], browsers, CLICKS_PER_BROWSER, repeats=1 if quick else 3)
        console.print(browsers, load(), sep="\n")
        browser.close()


if __name__ == "__main__":
    tyro.cli(main)
