// The leaderboard: a page over the picture with the methods' scores, from which every number opens its targets.
// The server says what is shown (`state.board`) and gives the numbers (`board`, `board_figures`).
(() => {
  "use strict";

  const { call, element, onState } = window.poseInspector;

  const SCORES = { average: "AR", vsd: "AR_VSD", mssd: "AR_MSSD", mspd: "AR_MSPD" };
  const CRITERIA = { average: "mssd", vsd: "vsd", mssd: "mssd", mspd: "mspd" };
  const COLORS = ["#3c96ff", "#ff9628"];
  const SVG = "http://www.w3.org/2000/svg";

  let shown = { open: false };
  let version = -1; // of the numbers that are here
  let figuresOf = null; // what the bars and curves on the page are of
  let numbers = null;
  let kind = "average"; // what is shown of the four
  let sort = { column: "average", descending: true };

  // ---------------------------------------------------------------- small helpers
  const button = (text, title, action, classes = "") => {
    const node = element("button", `pi-button ${classes}`, text);
    node.type = "button";
    node.title = title;
    node.onclick = (event) => { event.stopPropagation(); action(); };
    return node;
  };

  const score = (value) => (value === null || value === undefined ? "–" : (100 * value).toFixed(1));

  const seconds = (value) => {
    if (value === null || value === undefined) return "–";
    return value < 10 ? value.toFixed(2) : value.toFixed(1);
  };

  function svg(tag, attributes = {}, text = "") {
    const node = document.createElementNS(SVG, tag);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    if (text) node.textContent = text;
    return node;
  }

  // The score that is shown: the one asked for, or where the dataset looked at has none (no depth, no AR), the next.
  const hasScore = (name) => numbers.rows.some((row) => typeof row.cells[numbers.here]?.scores?.[name] === "number");
  function shownScore() {
    const evaluated = numbers.rows.some((row) => row.cells[numbers.here]?.scores);
    if (!evaluated || hasScore(shown.score)) return shown.score;
    return Object.keys(SCORES).find(hasScore) ?? shown.score;
  }
  const whyNot = () => numbers.rows.map((row) => row.cells[numbers.here]?.why_no_vsd).find(Boolean) ?? "";

  const choose = (changes) => call("board_show", changes);

  // ---------------------------------------------------------------- the page
  const root = element("section", "pi-board");
  root.setAttribute("role", "dialog");
  root.setAttribute("aria-label", "Leaderboard");
  root.hidden = true;
  const head = root.appendChild(element("header", "pi-board-head"));
  const table = root.appendChild(element("div", "pi-board-table"));
  const figures = root.appendChild(element("div", "pi-board-figures"));

  function drawHead() {
    const kinds = element("div", "pi-choice");
    const note = numbers.note || (whyNot() && `No VSD, so no AR: ${whyNot()}`);
    for (const [name, label] of Object.entries(SCORES)) {
      const item = button(label, `Show ${label}`, () => choose({ score: name }));
      item.setAttribute("aria-pressed", String(kind === name));
      if (whyNot() !== "" && !hasScore(name)) {
        item.disabled = true;
        item.title = `No ${label}: ${whyNot()}`;
      }
      kinds.append(item);
    }
    head.replaceChildren(
      element("h2", "", "Leaderboard"),
      kinds,
      element("span", "pi-board-note", note),
      button("Add results…", "Upload a results file (CSV) of a method", () => call("command", "add_results"), "pi-main"),
      button("×", "Close (Esc)", () => choose({ open: false }), "pi-close"),
    );
  }

  // ---------------------------------------------------------------- the table
  const valueOf = (row, column) => {
    if (column === "name") return row.name.toLowerCase();
    if (column === "seconds") return row.seconds ?? Infinity;
    if (column === "average") return row.average[kind] ?? -1;
    return row.cells[column]?.scores?.[kind] ?? -1;
  };

  const severalDatasets = () => numbers.datasets.length > 1;

  function sorted() {
    const sign = sort.descending ? -1 : 1;
    return [...numbers.rows].sort((a, b) => {
      const [x, y] = [valueOf(a, sort.column), valueOf(b, sort.column)];
      return sign * (x < y ? -1 : x > y ? 1 : 0);
    });
  }

  function heading(column, text, title, classes = "") {
    const cell = element("th", classes);
    const mark = sort.column === column ? (sort.descending ? " ▾" : " ▴") : "";
    cell.append(button(text + mark, title, () => {
      const same = sort.column === column;
      const smallFirst = column === "name" || column === "seconds";
      sort = { column, descending: same ? !sort.descending : !smallFirst };
      drawTable();
    }));
    return cell;
  }

  function headings() {
    const line = element("tr");
    line.append(element("th", "pi-pick", ""), heading("name", "method", "Sort by name", "pi-name"));
    for (const dataset of numbers.datasets) {
      const cell = heading(dataset.key, dataset.name, `${dataset.title}: sort by ${SCORES[kind]}`);
      if (dataset.key === numbers.here) cell.classList.add("pi-here");
      cell.append(element("div", "pi-small", dataset.remark), element("div", "pi-small pi-parts", "VSD MSSD MSPD"));
      line.append(cell);
    }
    if (severalDatasets()) line.append(heading("average", numbers.average_name, numbers.average_title));
    line.append(heading("seconds", "time [s]", "Mean time per image, as reported in the results file"));
    line.append(element("th"));
    return line;
  }

  function bar(value) {
    const node = element("span", "pi-fill");
    node.style.width = `${Math.round(100 * (value ?? 0))}%`;
    return node;
  }

  function jobCell(job) {
    const cell = element("div", "pi-cell-job");
    const left = job.left === null ? "" : `, ${Math.ceil(job.left)} s left`;
    const text = job.state === "running" ? `${Math.round(100 * job.share)} %${left}` : job.state;
    const fill = bar(job.state === "running" ? job.share : 0);
    cell.append(fill, element("span", "pi-value", text));
    cell.append(button("cancel", "Stop this evaluation", () => call("board_cancel", job.id)));
    return cell;
  }

  function scoreCell(row, dataset) {
    const cell = element("td", dataset.key === numbers.here ? "pi-here" : "");
    const entry = row.cells[dataset.key];
    if (!entry) return cell;
    if (entry.job) {
      cell.append(jobCell(entry.job));
      return cell;
    }
    if (!entry.scores) {
      cell.append(element("span", entry.failure ? "pi-failed" : "pi-dim", entry.failure ? "failed" : "not evaluated"));
      cell.append(button("evaluate", "Evaluate in the background", () => call("board_evaluate", entry.submission)));
      if (entry.failure) cell.append(element("div", "pi-small pi-reason", entry.failure));
      return cell;
    }
    const value = entry.scores[kind];
    const node = element("button", "pi-number");
    node.type = "button";
    node.append(bar(value), element("span", "pi-value", score(value)));
    const parts = ["vsd", "mssd", "mspd"].map((name) => score(entry.scores[name])).join("  ");
    const why = value === null ? `\n${entry.why_no_vsd}` : "";
    node.title = Object.entries(SCORES).map(([name, label]) => `${label} ${score(entry.scores[name])}`).join("   ")
      + `\n${entry.targets} instances${entry.remark ? `, ${entry.remark}` : ""}${why}\nOpen its targets, the worst first`;
    node.onclick = () => openTargets(entry.submission, dataset.key);
    cell.append(node, element("div", "pi-small pi-parts", parts));
    return cell;
  }

  function openTargets(submission, dataset, more = {}) {
    call("board_targets", submission, dataset, { criterion: CRITERIA[kind], ...more });
  }

  function pick(row) {
    const cell = element("td", "pi-pick");
    const own = row.cells[numbers.here]?.submission ?? null;
    for (const [place, name] of [["first", "A"], ["second", "B"]]) {
      const on = own !== null && shown[place] === own;
      const mark = button(name, `Show bars and curves as ${name}`, () => choose({ first: shown.first, second: shown.second, [place]: on ? null : own }), `pi-${place}`);
      mark.disabled = own === null || !row.cells[numbers.here].scores;
      mark.setAttribute("aria-pressed", String(on));
      cell.append(mark);
    }
    return cell;
  }

  function nameCell(row) {
    const cell = element("td", "pi-name");
    cell.append(element("div", "", row.name));
    const about = [row.description, ...Object.entries(row.properties).map(([key, value]) => `${key}: ${value}`)];
    const text = about.filter(Boolean).join(" · ");
    cell.append(element("div", "pi-small", text));
    cell.title = text;
    return cell;
  }

  function drawTable() {
    const body = element("table");
    body.append(headings());
    sorted().forEach((row) => {
      const line = element("tr");
      line.append(pick(row), nameCell(row), ...numbers.datasets.map((dataset) => scoreCell(row, dataset)));
      const mean = element("td", "pi-mean", score(row.average[kind]));
      mean.title = row.average_note;
      if (severalDatasets()) line.append(mean);
      line.append(element("td", "pi-mean", seconds(row.seconds)));
      const actions = element("td", "pi-actions");
      actions.append(button("edit", "Name, description, properties", () => call("board_edit", row.submission)));
      line.append(actions);
      body.append(line);
    });
    const empty = element("p", "pi-dim", "No results yet. Add a results file to see its scores here.");
    table.replaceChildren(numbers.rows.length ? body : empty);
  }

  // ---------------------------------------------------------------- bars and curves of one or two methods
  function card(title, remark, content) {
    const node = element("figure", "pi-card");
    const caption = element("figcaption");
    caption.append(element("b", "", title), element("span", "pi-dim", ` ${remark}`));
    node.append(caption, content);
    return node;
  }

  function bars(groups, methods) {
    const list = element("div", "pi-bars");
    for (const group of groups) {
      const line = element("button", "pi-bar-line");
      line.type = "button";
      line.append(element("span", "pi-bar-label", group.label));
      const pair = element("span", "pi-bar-pair");
      group.values.forEach((value, index) => {
        const track = element("span", "pi-track");
        const fill = bar(value);
        fill.style.background = methods[index].color;
        track.append(fill, element("span", "pi-value", score(value)));
        track.onclick = (event) => {
          event.stopPropagation();
          openTargets(methods[index].submission, numbers.here, group.filter);
        };
        track.title = `${methods[index].name}: ${score(value)} on ${group.count} instances of ${group.label}\nOpen them`;
        pair.append(track);
      });
      line.append(pair, element("span", "pi-small", `${group.count}`));
      line.onclick = () => openTargets(methods[0].submission, numbers.here, group.filter);
      list.append(line);
    }
    return list;
  }

  // A line chart: x and y in data units, y from 0 to 1; lines with null have a gap there.
  function chart(x, lines, axis) {
    const [width, height, left, bottom] = [300, 170, 30, 26];
    const low = axis.from ?? 0;
    const high = axis.to ?? Math.max(...x);
    const px = (value) => left + ((value - low) / (high - low)) * (width - left - 8);
    const py = (value) => (height - bottom) - value * (height - bottom - 8);
    const node = svg("svg", { viewBox: `0 0 ${width} ${height}`, class: "pi-chart" });
    for (const value of [0, 0.25, 0.5, 0.75, 1]) {
      node.append(svg("line", { x1: left, x2: width - 8, y1: py(value), y2: py(value), class: "pi-grid" }));
      node.append(svg("text", { x: left - 5, y: py(value) + 3, class: "pi-tick pi-right" }, String(100 * value)));
    }
    for (const value of axis.ticks)
      node.append(svg("text", { x: px(value), y: height - bottom + 12, class: "pi-tick" }, String(value)));
    node.append(svg("text", { x: (left + width) / 2, y: height - 2, class: "pi-tick" }, axis.label));
    for (const line of lines) {
      let path = "";
      line.y.forEach((value, index) => {
        if (value === null) return;
        const start = index === 0 || line.y[index - 1] === null;
        path += `${start ? "M" : "L"}${px(x[index]).toFixed(1)} ${py(value).toFixed(1)}`;
      });
      node.append(svg("path", { d: path, stroke: line.color, "stroke-dasharray": line.dash ?? "", class: "pi-line" }));
      line.y.forEach((value, index) => {
        if (value === null) return;
        const dot = svg("circle", { cx: px(x[index]), cy: py(value), r: 2.6, fill: line.color });
        dot.append(svg("title", {}, `${line.name}: ${(100 * value).toFixed(1)} % at ${line.at?.[index] ?? x[index]}`));
        node.append(dot);
      });
    }
    return node;
  }

  function drawFigures(data) {
    const methods = data.methods.map((method, index) => ({ ...method, color: COLORS[method.place === "second" ? 1 : 0] }));
    if (methods.length === 0) {
      const waiting = numbers.rows.some((row) => row.cells[numbers.here]?.job);
      const some = numbers.rows.some((row) => row.cells[numbers.here]?.scores);
      const hint = waiting ? "Bars and curves follow when a method has been evaluated."
        : some ? "Mark a method with A, and another with B, to see bars and curves."
        : "No method has been evaluated on this dataset.";
      figures.replaceChildren(element("p", "pi-dim", numbers.rows.length ? hint : ""));
      return;
    }
    const legend = element("div", "pi-board-legend");
    for (const method of methods) {
      const dot = element("span", "pi-dot");
      dot.style.background = method.color;
      legend.append(dot, element("b", "", method.name), element("span", "pi-dim", `${method.instances} instances of ${data.dataset}`));
    }
    const by = element("div", "pi-choice");
    for (const kind of ["object", "scene"]) {
      const item = button(`per ${kind}`, `Bars per ${kind}`, () => choose({ by: kind }));
      item.setAttribute("aria-pressed", String(shown.by === kind));
      by.append(item);
    }
    legend.append(by);
    const cards = element("div", "pi-cards");
    cards.append(card(`${SCORES[kind]} per ${shown.by}`, "a click opens the targets", bars(data.groups, methods)));
    for (const curve of data.curves) {
      const lines = curve.lines.map((line) => ({ ...line, color: methods[line.method].color, name: methods[line.method].name }));
      cards.append(card(curve.title, curve.remark, chart(curve.x, lines, curve.axis)));
    }
    figures.replaceChildren(legend, cards);
  }

  // ---------------------------------------------------------------- following the server
  async function update(state) {
    const board = state.board ?? { open: false };
    const before = shown;
    shown = board;
    root.hidden = !board.open;
    document.body.classList.toggle("pi-board-open", board.open);
    if (!board.open) return;
    const news = board.version !== version;
    if (news) {
      version = board.version;
      numbers = await call("board");
    }
    if (numbers === null) return;
    kind = shownScore();
    drawHead();
    if (news || before.score !== board.score || before.first !== board.first || before.second !== board.second || !before.open)
      drawTable();
    const wanted = JSON.stringify([board.first, board.second, kind, board.by, board.figures, numbers.here]);
    if (wanted === figuresOf) return;
    figuresOf = wanted;
    const data = await call("board_figures", kind);
    if (data !== null && wanted === figuresOf) drawFigures(data);
  }

  window.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || !shown.open || document.querySelector(".mantine-Modal-content")) return;
    event.stopImmediatePropagation();
    choose({ open: false });
  }, true);

  document.addEventListener("DOMContentLoaded", () => document.body.append(root));
  onState(update);
})();
