// The page of `inspector symmetries`: lists beside viser's picture, what lies over it, and keys. The server holds all
// state, the same for every browser; this script asks (`call`), listens (`listen`) and draws what it is told.
(() => {
  "use strict";

  const CAMERA_KEYS = new Set(["KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE"]);
  const STANDING = { accepted: "accepted", refused: "refused", follows: "follows", open: "open" };
  const MARKS = { accepted: "✓", refused: "✕", follows: "✓", open: "" };

  let key = null; // names the channel; the server puts it into the page
  let state = null;

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

  const command = (name) => call("command", name);

  // Calls a method at most once at a time; of what arrives meanwhile only the last counts.
  function latest(method) {
    let busy = false;
    let waiting = null;
    return async (...args) => {
      waiting = args;
      if (busy) return;
      busy = true;
      while (waiting !== null) {
        const now = waiting;
        waiting = null;
        await call(method, ...now);
      }
      busy = false;
    };
  }

  async function listen(mine) {
    let version = 0;
    while (key === mine) {
      try {
        const query = new URLSearchParams({ key: mine, since: version });
        const response = await fetch(`/inspector/state?${query}`, { cache: "no-store" });
        if (response.status === 403 || response.status === 404) return;
        if (response.ok) {
          const next = await response.json();
          if (next.version !== version) {
            version = next.version;
            state = next;
            draw();
          }
        }
      } catch {
        await new Promise((resolve) => setTimeout(resolve, 1000));
      }
    }
  }

  // ---------------------------------------------------------------- small DOM helpers: text is never parsed as HTML
  function element(tag, classes = "", text = "", children = []) {
    const node = document.createElement(tag);
    if (classes) node.className = classes;
    if (text !== "") node.textContent = text;
    node.append(...children);
    return node;
  }

  function button(name, text, classes = "", title = "") {
    const found = state.commands.find((one) => one.name === name);
    const node = element("button", `ps-button ${classes}`, text);
    if (found) node.append(element("kbd", "", found.shown));
    node.title = title || found?.label || "";
    node.dataset.command = name;
    node.onclick = () => command(name);
    return node;
  }

  const mm = (value) => (value < 0.1 ? value.toFixed(3) : value < 10 ? value.toFixed(2) : value.toFixed(1));
  const percent = (share) => `${(share * 100).toFixed(share < 0.1 ? 2 : 1)} %`;
  const sign = (fold, kind) => (kind === "any rotation" ? "●" : fold === 0 ? "∞" : String(fold));

  // ---------------------------------------------------------------- the panel
  const panel = {
    root: null,

    mount(root) {
      this.root = root;
      root.replaceChildren();
      this.head = root.appendChild(element("div", "ps-head"));
      this.objects = root.appendChild(element("div", "ps-objects"));
      this.about = root.appendChild(element("div", "ps-about"));
      this.candidates = root.appendChild(element("div", "ps-candidates"));
      this.result = root.appendChild(element("div", "ps-result"));
      this.actions = root.appendChild(element("div", "ps-actions"));
      for (const list of [this.objects, this.candidates]) list.setAttribute("role", "listbox");
      this.objects.setAttribute("aria-label", "objects");
      this.candidates.setAttribute("aria-label", "candidates");
    },

    fit() {
      if (!this.root?.isConnected) return;
      const top = this.root.getBoundingClientRect().top;
      if (top > 0) this.root.style.height = `${Math.max(320, window.innerHeight - top - 8)}px`;
    },

    draw() {
      if (!this.root?.isConnected) return;
      this.fit();
      this.drawHead();
      this.drawObjects();
      this.drawAbout();
      this.drawCandidates();
      this.drawResult();
      this.drawActions();
    },

    drawHead() {
      const done = state.objects.filter((one) => one.progress === "found" || one.progress === "failed").length;
      const text = done < state.objects.length
        ? `searched ${done} of ${state.objects.length}`
        : `${state.objects.length} object${state.objects.length === 1 ? "" : "s"}`;
      const parts = state.folder.split("/").filter(Boolean);
      const folder = element("span", "ps-folder", parts.length > 2 ? `… / ${parts.slice(-2).join(" / ")}` : parts.join(" / "));
      folder.title = state.folder;
      this.head.replaceChildren(folder, element("span", "ps-dim", text));
    },

    drawObjects() {
      this.objects.hidden = state.objects.length < 2;
      const rows = state.objects.map((one, index) => {
        const row = element("div", "ps-object");
        row.setAttribute("role", "option");
        row.setAttribute("aria-selected", String(one.selected));
        row.title = one.problem;
        row.append(element("span", "ps-name", one.name), element("span", "ps-unsaved", one.unsaved ? "not saved" : ""), this.badge(one));
        row.onclick = () => call("select_object", index);
        return row;
      });
      this.objects.replaceChildren(...rows);
      keepInSight(this.objects, rows.find((row) => row.getAttribute("aria-selected") === "true"));
    },

    badge(one) {
      if (one.progress === "failed") return element("span", "ps-badge ps-bad", "failed");
      if (one.progress === "waiting") return element("span", "ps-dim", "waiting");
      if (one.progress === "searching") {
        const bar = element("span", "ps-bar", "", [element("i")]);
        bar.firstChild.style.width = `${Math.round(one.share * 100)}%`;
        return bar;
      }
      if (one.accepted) return element("span", "ps-badge ps-good", `✓ ${one.accepted}`);
      if (one.suggested) return element("span", "ps-badge ps-hint", `${one.suggested} suggested`);
      if (one.decided) return element("span", "ps-dim", "none accepted");
      return element("span", "ps-dim", one.count ? `${one.count} candidate${one.count === 1 ? "" : "s"}, none suggested` : "none");
    },

    drawAbout() {
      const now = state.current;
      const parts = [element("h3", "", now.name)];
      if (now.diameter_mm !== null) parts.push(element("span", "ps-dim", `diameter ${now.diameter_mm.toFixed(1)} mm`));
      if (now.epsilon_mm !== null) {
        const limits = element("span", "ps-dim ps-limits", `suggested up to ε = ${mm(now.epsilon_mm)} mm, listed up to ${mm(now.bound_mm)} mm`);
        limits.title = "Hausdorff distance: the farthest that any point of the turned model comes to lie from the model";
        parts.push(limits);
      }
      if (now.problem) parts.push(element("div", "ps-problem", now.problem));
      this.about.replaceChildren(...parts);
    },

    drawCandidates() {
      const now = state.current;
      if (!state.candidates.length) {
        const text = { waiting: "Waiting for its turn …", searching: "Searching …", failed: "", found: "No symmetry comes below the bound." };
        this.candidates.replaceChildren(element("div", "ps-empty", text[now.progress]));
        return;
      }
      const rows = state.candidates.map((one, index) => this.candidate(one, index, now));
      const lines = [...rows];
      const above = state.candidates.findIndex((one) => !one.within);
      if (above >= 0) lines.splice(above, 0, element("div", "ps-above", `above ε = ${mm(now.epsilon_mm)} mm`));
      this.candidates.replaceChildren(...lines);
      keepInSight(this.candidates, rows[state.selected]);
    },

    candidate(one, index, now) {
      const row = element("div", `ps-candidate ps-is-${STANDING[one.standing]}`);
      row.setAttribute("role", "option");
      row.setAttribute("aria-selected", String(index === state.selected));
      row.dataset.standing = one.standing;
      const what = element("div", "ps-what", "", [element("b", "", one.kind), element("span", "ps-axis", one.kind === "any rotation" ? "" : `about ${one.axis}`)]);
      const gauge = element("div", "ps-gauge", "", [element("i", one.within ? "ps-within" : ""), element("u")]);
      gauge.firstChild.style.width = `${Math.min(100, (100 * one.distance_mm) / now.bound_mm)}%`;
      gauge.lastChild.style.left = `${Math.min(100, (100 * now.epsilon_mm) / now.bound_mm)}%`;
      const told = one.standing === "follows" ? "follows" : one.standing !== "open" ? one.standing : one.suggested ? "suggested" : "";
      if (one.accepted_fold) what.firstChild.append(element("span", "ps-part", ` as ${one.accepted_fold}-fold`));
      row.append(
        element("span", "ps-fold", sign(one.fold, one.kind)),
        element("div", "ps-middle", "", [what, gauge]),
        element("div", "ps-number", "", [element("b", "", `${mm(one.distance_mm)} mm`), element("span", "ps-dim", percent(one.share))]),
        element("div", `ps-standing ps-${told || "none"}`, told ? `${MARKS[one.standing]} ${told}`.trim() : ""),
      );
      row.title = one.offset ? `through ${one.offset} mm` : "through the origin";
      row.onclick = () => call("select", index);
      return row;
    },

    drawResult() {
      const now = state.current;
      this.result.hidden = now.progress !== "found";
      const told = now.unsaved ? "not saved yet" : now.as_listed ? "as in models_info.json" : `models_info.json lists ${now.listed}`;
      const lines = [
        element("div", "ps-result-line", "", [element("span", "ps-dim", "accepted set"), element("b", "", now.group)]),
        element("div", "ps-result-line", "", [element("span", "ps-dim", "to be listed"), element("span", "", now.written)]),
        element("div", `ps-result-line ${now.unsaved ? "ps-warn" : "ps-dim"}`, told),
      ];
      this.result.replaceChildren(...lines);
    },

    drawActions() {
      const chosen = state.candidates[state.selected];
      const first = element("div", "ps-row");
      if (chosen) {
        first.append(
          button("accept", "Accept", `ps-accept ${chosen.standing === "accepted" ? "ps-on" : ""}`),
          button("refuse", "Refuse", `ps-refuse ${chosen.standing === "refused" ? "ps-on" : ""}`),
          button("reopen", "Leave open", ""),
        );
      }
      if (chosen?.folds.length) {
        const parts = [0, ...chosen.folds].map((fold) => {
          const node = element("button", `ps-part-choice ${fold === state.fold ? "ps-on" : ""}`, fold ? `${fold}` : chosen.fold ? `all ${chosen.fold}` : "any angle");
          node.onclick = () => call("fold", fold);
          return node;
        });
        const row = element("div", "ps-parts", "", [element("span", "ps-dim", "turns"), ...parts]);
        row.title = "Where colours allow only some of the turns, accept only those ( − and + )";
        this.actions.replaceChildren(row, first);
      } else this.actions.replaceChildren(first);
      const second = element("div", "ps-row", "", [button("suggested", "Accept suggested"), button("undo", "Undo")]);
      const save = button("save", state.unsaved ? `Save ${state.unsaved} object${state.unsaved === 1 ? "" : "s"}` : "Saved", state.unsaved ? "ps-save" : "");
      if (!state.can_save) {
        save.disabled = true;
        save.title = "The file is not named obj_ID.ply, so no entry of models_info.json is its own";
      }
      second.append(save);
      this.actions.append(second);
    },
  };

  function keepInSight(list, row) {
    if (!row) return;
    const [top, bottom] = [row.offsetTop - list.offsetTop, row.offsetTop - list.offsetTop + row.offsetHeight];
    if (top < list.scrollTop) list.scrollTop = top;
    else if (bottom > list.scrollTop + list.clientHeight) list.scrollTop = bottom - list.clientHeight;
  }

  // ---------------------------------------------------------------- what lies over the picture
  const overlay = {
    build() {
      this.root = document.body.appendChild(element("div", "pi-overlay ps-overlay"));
      this.legend = this.root.appendChild(element("div", "pi-legend"));
      const bottom = this.root.appendChild(element("div", "ps-bottom"));
      this.message = bottom.appendChild(element("div", "ps-message"));
      this.message.setAttribute("role", "status");
      this.bar = bottom.appendChild(element("div", "ps-bar-of-tools"));
      this.modes = this.bar.appendChild(element("div", "ps-modes"));
      this.turn = this.bar.appendChild(element("div", "ps-turn"));
      this.play = this.turn.appendChild(element("button", "ps-button ps-play"));
      this.play.onclick = () => command("play");
      this.slider = this.turn.appendChild(element("input", "ps-slider"));
      Object.assign(this.slider, { type: "range", min: 0, max: 360, step: 0.5 });
      this.slider.setAttribute("aria-label", "angle");
      this.ticks = this.turn.appendChild(element("datalist"));
      this.ticks.id = "ps-ticks";
      this.slider.setAttribute("list", "ps-ticks");
      this.angle = this.turn.appendChild(element("span", "ps-angle"));
      const send = latest("angle");
      this.slider.oninput = () => send(this.snapped(Number(this.slider.value)));
      setInterval(() => this.place(), 200);
    },

    // Near a turn of the symmetry the slider means just that turn.
    snapped(angle) {
      const fold = shownFold();
      if (fold < 2) return angle;
      const turn = (Math.round((angle * fold) / 360) * 360) / fold;
      return Math.abs(turn - angle) < Math.min(4, 90 / fold) ? turn : angle;
    },

    place() {
      const canvas = document.querySelector("canvas[data-engine]");
      if (canvas === null) return;
      const box = canvas.getBoundingClientRect();
      Object.assign(this.root.style, { left: `${box.left}px`, top: `${box.top}px`, width: `${box.width}px`, height: `${box.height}px` });
      panel.fit();
    },

    draw() {
      const chosen = state.candidates[state.selected];
      this.legend.replaceChildren(...this.lines(chosen));
      this.bar.hidden = !chosen;
      this.drawMessage();
      if (chosen) this.drawTools(chosen);
    },

    lines(chosen) {
      const line = (classes, ...children) => element("div", `pi-legend-line ${classes}`, "", children);
      const title = chosen
        ? `${state.current.name}, candidate ${state.selected + 1} of ${state.candidates.length}: ${chosen.kind}${chosen.kind === "any rotation" ? "" : ` about ${chosen.axis}`}`
        : state.current.name;
      const lines = [line("pi-title", element("span", "", title))];
      if (!chosen) return lines;
      const relation = chosen.within ? "within" : "above";
      lines.push(line(chosen.within ? "ps-line-good" : "ps-line-bad", element("span", "", `Hausdorff distance ${mm(chosen.distance_mm)} mm, ${percent(chosen.share)} of the diameter: ${relation} ε = ${mm(state.current.epsilon_mm)} mm`)));
      if (chosen.at_axis_mm > 1.05 * chosen.distance_mm + 0.01) {
        lines.push(line("pi-minor", element("span", "", `smallest about an axis nearby; about the one that fits the whole surface best: ${mm(chosen.at_axis_mm)} mm, mean ${mm(chosen.mean_mm)} mm`)));
      }
      const look = state.look;
      if (look.mode === "distance") {
        const bar = element("span", "pi-scale");
        bar.style.background = `linear-gradient(to right, ${state.palette.stops.join(",")})`;
        lines.push(line("", element("span", "", "distance to its turned self"), element("span", "pi-end", "0"), bar, element("span", "pi-end", `${mm(2 * state.current.epsilon_mm)} mm = 2 ε`)));
      } else {
        lines.push(line("", dot(state.palette.model), element("span", "", "model"), dot(state.palette.turned), element("span", "", "its turned self")));
      }
      return lines;
    },

    drawTools(chosen) {
      const look = state.look;
      const mode = (name, text) => button(name, text, look.mode === name ? "ps-on" : "");
      this.modes.replaceChildren(mode("overlay", "Overlay"), mode("blink", "Blink"), mode("distance", "Distance"), button("colors", "Own colours", look.colors ? "ps-on" : ""));
      this.play.textContent = look.playing ? "❚❚" : "▶";
      this.play.title = look.playing ? "Stop (Space)" : "Turn about the axis (Space)";
      if (document.activeElement !== this.slider || look.playing) this.slider.value = look.angle;
      const fold = shownFold();
      const count = fold > 1 && fold <= 36 ? fold + 1 : 0;
      if (this.ticks.childElementCount !== count) {
        this.ticks.replaceChildren(...Array.from({ length: count }, (_, k) => {
          const option = element("option");
          option.value = (360 * k) / fold;
          return option;
        }));
      }
      const measured = look.measured_mm === null ? "" : `${mm(look.measured_mm)} mm`;
      this.angle.replaceChildren(element("b", "", `${look.angle.toFixed(look.angle % 1 ? 1 : 0)}°`), element("span", "ps-dim", measured));
    },

    drawMessage() {
      const { text, kind } = state.message;
      this.message.textContent = text;
      this.message.className = `ps-message ps-message-${kind}`;
      this.message.hidden = text === "";
    },
  };

  const shownFold = () => state?.fold || (state?.candidates[state.selected]?.fold ?? 0);

  function dot(color) {
    const node = element("span", "pi-dot");
    node.style.background = color;
    return node;
  }

  function draw() {
    const unsaved = state.unsaved ? "● " : "";
    document.title = `${unsaved}${state.current.name} - symmetries`;
    panel.draw();
    overlay.draw();
  }

  // ---------------------------------------------------------------- keys
  function named(event) {
    const parts = [event.ctrlKey || event.metaKey ? "Ctrl" : "", event.shiftKey && event.key.length === 1 && event.key.toLowerCase() !== event.key.toUpperCase() ? "Shift" : ""];
    return [...parts.filter(Boolean), event.key.length === 1 ? event.key.toLowerCase() : event.key].join("+");
  }

  function followKeys() {
    window.addEventListener("keydown", (event) => {
      const target = event.target;
      const typing = target instanceof HTMLElement && (["INPUT", "TEXTAREA", "SELECT"].includes(target.tagName) || target.isContentEditable) && target.type !== "range";
      if (typing || event.altKey || state === null) return;
      const sliding = target instanceof HTMLElement && target.type === "range" && event.key.startsWith("Arrow");
      if (sliding) return;
      const pressed = named(event);
      const found = state.commands.find((one) => one.keys.includes(pressed));
      if (found) {
        event.stopImmediatePropagation();
        event.preventDefault();
        if (!event.repeat || ["next", "previous", "next_object", "previous_object", "turn_on", "turn_back"].includes(found.name)) command(found.name);
      } else if (event.key === "?") {
        event.stopImmediatePropagation();
        help.toggle();
      } else if (event.key === "Escape") {
        help.close();
      } else if (CAMERA_KEYS.has(event.code) && !event.ctrlKey && !event.metaKey) {
        event.stopImmediatePropagation(); // viser's camera would fly away
      }
    }, true);
    window.addEventListener("beforeunload", (event) => {
      if (state?.unsaved) event.preventDefault();
    });
  }

  const help = {
    toggle() {
      if (this.root) return this.close();
      const cells = state.commands.flatMap((one) => [element("kbd", "", one.shown), element("span", "", one.label)]);
      cells.push(element("kbd", "", "Ctrl K"), element("span", "", "Find a command by name"));
      const close = element("button", "ps-button", "Close");
      close.onclick = () => this.close();
      this.root = document.body.appendChild(element("div", "ps-help", "", [element("h3", "", "Keys"), element("div", "pi-keys", "", cells), close]));
    },
    close() {
      this.root?.remove();
      this.root = null;
    },
  };

  // ---------------------------------------------------------------- start: wait for the channel's key in the page
  function adopt() {
    const root = document.getElementById("ps-root");
    if (root === null) return;
    if (panel.root !== root) {
      panel.mount(root);
      if (state !== null) draw();
    }
    if (root.dataset.key !== key) {
      key = root.dataset.key;
      listen(key);
    }
  }

  // Viser greets users without a GPU with a large notice over the picture; it need not stay.
  function dismissNotice() {
    for (const notice of document.querySelectorAll(".mantine-Notification-root")) {
      if (notice.textContent.includes("Software WebGL")) notice.querySelector("button")?.click();
    }
  }

  document.addEventListener("DOMContentLoaded", () => {
    overlay.build();
    followKeys();
    new MutationObserver(() => { adopt(); dismissNotice(); }).observe(document.body, { childList: true, subtree: true });
    window.addEventListener("resize", () => panel.fit());
  });
})();
