// What viser's page lacks for this application: a table of any length, the mouse in the image, keys, and an
// address bar that names what is seen. The server holds all state; this script asks (`call`) and listens (`listen`).
(() => {
  "use strict";

  const ROW_HEIGHT = 26;
  const CAMERA_KEYS = new Set(["KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE"]);
  const ARROWS = { ArrowDown: "next", ArrowUp: "previous", ArrowRight: "next_image", ArrowLeft: "previous_image" };

  let key = null; // names this browser's session; the server puts it into the page
  const NOTHING = { version: 0, view: "image", columns: [], rows: 0, selected: -1, legend: [], progress: [] };
  let state = NOTHING;
  const followers = []; // told of every new state

  // ---------------------------------------------------------------- the channel to the server
  async function call(method, ...args) {
    if (key === null) return null;
    const query = new URLSearchParams({ key, method, args: JSON.stringify(args) });
    try {
      const response = await fetch(`/inspector/call?${query}`, { cache: "no-store" });
      return response.ok ? await response.json() : null;
    } catch { // the page is being left, or the server went away, which viser shows itself
      return null;
    }
  }

  // Calls a method at most once at a time; what arrives meanwhile is merged into one later call.
  function merged(method, merge, answered = () => {}) {
    let busy = false;
    let waiting = null;
    return async function send(args) {
      waiting = waiting === null ? args : merge(waiting, args);
      if (busy) return;
      busy = true;
      while (waiting !== null) {
        const now = waiting;
        waiting = null;
        answered(await call(method, ...now));
      }
      busy = false;
    };
  }

  async function listen(mine) {
    while (key === mine) {
      try {
        const query = new URLSearchParams({ key: mine, since: state.version });
        const response = await fetch(`/inspector/state?${query}`, { cache: "no-store" });
        if (response.status === 403 || response.status === 404) return;
        if (response.ok) apply(await response.json());
      } catch {
        await new Promise((resolve) => setTimeout(resolve, 1000));
      }
    }
  }

  function apply(next) {
    const before = state;
    state = { ...NOTHING, ...next };
    if (next.version === before.version) return;
    if (next.address !== undefined) showAddress(next.address);
    if (next.title) document.title = next.title;
    table.update(before);
    overlay.update();
    for (const follow of followers) follow(state);
  }

  // ---------------------------------------------------------------- the address bar names what is seen
  // (in the query: viser makes its WebSocket's address from the page's and stumbles over a fragment)
  const VISER_PARAMETERS = /^(fixedDpr|websocket|darkMode|show[A-Z]|hide[A-Z]|force[A-Z]|initial[A-Z]|log[A-Z])/;

  function showAddress(ours) {
    const kept = [...new URLSearchParams(location.search)].filter(([name]) => VISER_PARAMETERS.test(name));
    const query = [new URLSearchParams(kept).toString(), ours].filter((part) => part !== "").join("&");
    const address = location.pathname + (query ? `?${query}` : "");
    if (location.pathname + location.search !== address) history.replaceState(null, "", address);
  }

  // ---------------------------------------------------------------- small DOM helpers: text is never parsed as HTML
  function element(tag, classes = "", text = "") {
    const node = document.createElement(tag);
    if (classes) node.className = classes;
    if (text !== "") node.textContent = text;
    return node;
  }

  // ---------------------------------------------------------------- the table of targets
  const table = {
    root: null,
    shown: { first: 0, rows: [] },
    asked: 0,

    mount(root) {
      this.root = root;
      root.replaceChildren();
      this.head = root.appendChild(element("div", "pi-head"));
      this.body = root.appendChild(element("div", "pi-body"));
      this.body.setAttribute("role", "listbox");
      this.body.setAttribute("aria-label", "targets");
      this.spacer = this.body.appendChild(element("div", "pi-spacer"));
      this.lines = this.spacer.appendChild(element("div", "pi-lines"));
      this.body.addEventListener("scroll", () => this.fetch());
      this.fit();
      this.update({});
    },

    fit() {
      if (!this.root?.isConnected) return;
      const top = this.root.getBoundingClientRect().top;
      if (top > 0) this.root.style.height = `${Math.max(220, window.innerHeight - top - 10)}px`;
    },

    update(before) {
      if (!this.root?.isConnected) return;
      this.fit();
      this.head.replaceChildren(
        ...state.columns.map((column) => {
          const mark = column.id === state.sort ? (state.descending ? " ▾" : " ▴") : "";
          const cell = element("div", `pi-cell pi-${column.id}`, column.label + mark);
          cell.title = column.title;
          cell.onclick = () => call("sort", column.id);
          return cell;
        }),
      );
      this.spacer.style.height = `${state.rows * ROW_HEIGHT}px`;
      if (state.selected !== before.selected || state.rows_version !== before.rows_version) this.reveal();
      this.fetch(true);
    },

    reveal() {
      if (state.selected < 0) return;
      const top = state.selected * ROW_HEIGHT;
      const { scrollTop, clientHeight } = this.body;
      if (top < scrollTop || top + ROW_HEIGHT > scrollTop + clientHeight)
        this.body.scrollTop = Math.max(0, top - clientHeight / 2);
    },

    async fetch(force = false) {
      const height = this.body.clientHeight || 400;
      const first = Math.max(0, Math.floor(this.body.scrollTop / ROW_HEIGHT) - 20);
      const count = Math.ceil(height / ROW_HEIGHT) + 40;
      const covered = first >= this.shown.first && first + count <= this.shown.first + this.shown.rows.length;
      if (!force && (covered || Math.abs(first - this.shown.first) < 10)) return;
      const ticket = ++this.asked;
      const rows = await call("rows", first, count);
      if (rows === null || ticket !== this.asked) return;
      this.shown = rows;
      this.draw();
    },

    draw() {
      this.lines.style.transform = `translateY(${this.shown.first * ROW_HEIGHT}px)`;
      this.lines.replaceChildren(
        ...this.shown.rows.map((row, offset) => {
          const position = this.shown.first + offset;
          const line = element("div", `pi-row pi-is-${row.status}`);
          line.setAttribute("role", "option");
          line.setAttribute("aria-selected", String(position === state.selected));
          line.dataset.position = position;
          line.title = row.title;
          row.cells.forEach((text, index) => {
            line.append(element("div", `pi-cell pi-${state.columns[index]?.id}`, text));
          });
          line.onclick = () => call("select", position);
          return line;
        }),
      );
    },
  };

  // ---------------------------------------------------------------- what lies over the picture: legend and readout
  const overlay = {
    build() {
      this.root = document.body.appendChild(element("div", "pi-overlay"));
      this.legend = this.root.appendChild(element("div", "pi-legend"));
      this.progress = this.root.appendChild(element("div", "pi-progress"));
      this.readout = this.root.appendChild(element("div", "pi-readout"));
      setInterval(() => this.place(), 200);
    },

    place() {
      const canvas = mainCanvas();
      if (canvas === null) return;
      const box = canvas.getBoundingClientRect();
      const size = `${Math.round(box.width)}x${Math.round(box.height)}`;
      if (size !== this.size && key !== null && box.width > 0) {
        this.size = size;
        call("resize", Math.round(box.width), Math.round(box.height));
      }
      Object.assign(this.root.style, {
        left: `${box.left}px`, top: `${box.top}px`, width: `${box.width}px`, height: `${box.height}px`,
      });
      table.fit();
    },

    update() {
      this.root.dataset.view = state.view;
      this.root.classList.toggle("pi-busy", state.busy === true);
      this.legend.replaceChildren(
        ...state.legend.map((item) => {
          const line = element("div", `pi-legend-line ${item.class ?? ""}`);
          if (item.color) {
            const dot = element("span", "pi-dot");
            dot.style.background = item.color;
            line.append(dot);
          }
          line.append(element("span", "", item.text));
          if (item.stops) {
            const bar = element("span", "pi-scale");
            bar.style.background = `linear-gradient(to right, ${item.stops.join(",")})`;
            line.append(element("span", "pi-end", item.low), bar, element("span", "pi-end", item.high));
          }
          return line;
        }),
      );
      this.progress.replaceChildren(
        ...state.progress.map((job) => {
          const line = element("div", "pi-job");
          const bar = element("div", "pi-bar");
          bar.style.width = `${Math.round(job.share * 100)}%`;
          line.append(bar, element("span", "", `${job.text} ${Math.round(job.share * 100)} %`));
          return line;
        }),
      );
    },
  };

  // ---------------------------------------------------------------- the mouse in the image
  function mainCanvas() {
    return document.querySelector("canvas[data-engine]");
  }

  function place(event) {
    const box = mainCanvas().getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  }

  const onPicture = (event) => event.target === mainCanvas();
  const inImage = () => state.view === "image";
  const zoom = merged("zoom", (a, b) => [b[0], b[1], a[2] * b[2]]);
  const hover = merged("hover", (_, b) => b, (answer) => { overlay.readout.textContent = answer?.text ?? ""; });
  const pan = merged("pan", (a, b) => [a[0] + b[0], a[1] + b[1]]);

  function keepFromViser(event) {
    event.stopImmediatePropagation();
    event.preventDefault();
  }

  function followMouse() {
    let pressed = null; // where the button went down

    window.addEventListener("wheel", (event) => {
      if (!onPicture(event) || !inImage()) return;
      keepFromViser(event);
      zoom([...place(event), Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.0015))]);
    }, { capture: true, passive: false });

    window.addEventListener("pointerdown", (event) => {
      if (!onPicture(event)) return;
      pressed = { x: event.clientX, y: event.clientY, moved: 0, button: event.button };
      if (inImage()) keepFromViser(event);
      if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
    }, true);

    window.addEventListener("pointermove", (event) => {
      if (pressed !== null) {
        const [dx, dy] = [event.clientX - pressed.x, event.clientY - pressed.y];
        pressed = { ...pressed, x: event.clientX, y: event.clientY, moved: pressed.moved + Math.abs(dx) + Math.abs(dy) };
        if (inImage()) {
          keepFromViser(event);
          pan([dx, dy]);
        }
        return;
      }
      if (onPicture(event)) hover(place(event));
    }, true);

    window.addEventListener("pointerup", (event) => {
      const click = pressed !== null && pressed.moved < 4 && pressed.button === 0 && onPicture(event);
      if (pressed !== null && inImage()) keepFromViser(event);
      pressed = null;
      if (click) call("click", ...place(event), event.shiftKey);
    }, true);

    window.addEventListener("dblclick", (event) => {
      if (onPicture(event) && inImage()) call("command", "fit");
    }, true);

    window.addEventListener("pointerout", (event) => {
      if (event.target === mainCanvas()) overlay.readout.textContent = "";
    }, true);
  }

  // Pictures within the tabs that take clicks are marked with the name by which their view knows them.
  function followTouches() {
    window.addEventListener("click", (event) => {
      const touched = event.target instanceof Element ? event.target.closest("[data-touch]") : null;
      if (touched === null) return;
      const box = touched.getBoundingClientRect();
      call("touch", touched.dataset.touch, (event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
    });
  }

  // ---------------------------------------------------------------- keys that viser has no name for, or that move its camera
  function followKeys() {
    window.addEventListener("keydown", (event) => {
      const target = event.target;
      const typing = target instanceof HTMLElement
        && (["INPUT", "TEXTAREA", "SELECT"].includes(target.tagName) || target.isContentEditable
          || target.getAttribute("role") === "slider" || target.getAttribute("role") === "tab");
      if (typing || event.ctrlKey || event.metaKey || event.altKey || state.board?.open) return;
      if (event.key === "?") {
        keepFromViser(event);
        call("command", "help");
      } else if (ARROWS[event.key]) {
        keepFromViser(event);
        call("command", ARROWS[event.key]);
      } else if (inImage() && CAMERA_KEYS.has(event.code)) {
        keepFromViser(event);
      }
    }, true);
  }

  // ---------------------------------------------------------------- parts of panels that choose what is shown
  // `data-choose` holds a part of an address; what it does not name stays as it is.
  function followChoices() {
    const choose = (event) => {
      const chosen = event.target instanceof Element ? event.target.closest("[data-choose]") : null;
      if (chosen !== null) call("choose", chosen.dataset.choose);
      return chosen !== null;
    };
    window.addEventListener("click", choose);
    window.addEventListener("keydown", (event) => {
      if ((event.key === "Enter" || event.key === " ") && choose(event)) event.preventDefault();
    });
  }

  // ---------------------------------------------------------------- start: wait for the session's key in the page
  function adopt() {
    const root = document.getElementById("pi-targets");
    if (root === null) return;
    if (root.dataset.key !== key) {
      key = root.dataset.key;
      state = { ...state, version: 0 };
      overlay.size = null;
      call("hello", location.search.slice(1), window.innerWidth);
      listen(key);
    }
    if (table.root !== root) table.mount(root);
  }

  // Viser greets users without a GPU with a large notice over the picture; it need not stay.
  function dismissNotice() {
    for (const notice of document.querySelectorAll(".mantine-Notification-root")) {
      if (notice.textContent.includes("Software WebGL")) notice.querySelector("button")?.click();
    }
  }

  window.poseInspector = { call, element, onState: (follow) => followers.push(follow) };

  document.addEventListener("DOMContentLoaded", () => {
    overlay.build();
    followMouse();
    followTouches();
    followKeys();
    followChoices();
    new MutationObserver(() => { adopt(); dismissNotice(); }).observe(document.body, { childList: true, subtree: true });
    window.addEventListener("resize", () => { table.fit(); table.fetch(true); });
    window.addEventListener("popstate", () => call("open", location.search.slice(1)));
  });
})();
