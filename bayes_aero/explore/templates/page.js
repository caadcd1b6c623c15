const explore = (function () {
  "use strict";
  const at = (id) => document.getElementById(id);
  const state = {id: 0, manoeuvre: 0, window: null, values: {}, off: [], added: [], fan: false, export: null};
  let exchange, time, whole = [0, 1], waiting = false, due = false, sent = 0, built = "", patience = 0, fresh = null;

  const number = (x) => x === null || !isFinite(x) ? "–" : String(Number(x.toPrecision(4)));
  const exact = (x) => String(Number(x.toPrecision(6)));
  const near = (a, b) => Math.abs(a - b) < 1e-6 * Math.max(1, Math.abs(b));

  function make(kind, content, more) {
    const e = Object.assign(document.createElement(kind), more || {});
    e.append(...[].concat(content === undefined ? [] : content));
    return e;
  }

  function ask() {  // one question at a time; the last state follows as soon as the answer is there
    due = waiting;
    if (waiting) return;
    waiting = true;
    sent = performance.now();
    patience = setTimeout(() => { document.body.classList.add("waiting"); at("speed").textContent = "computing …"; }, 400);
    exchange.asked = JSON.stringify({...state, id: ++state.id});
    state.export = null;
  }

  function answered() {
    const told = JSON.parse(exchange.told);
    if (told.id !== state.id && told.id !== -1) return;
    clearTimeout(patience);
    document.body.classList.remove("waiting");
    waiting = false;
    at("error").textContent = told.error;
    if (told.groups) show(told);
    else undo();
    const id = state.id;
    requestAnimationFrame(() => requestAnimationFrame(() => {  // when what was sent is drawn
      const took = performance.now() - sent;
      if (told.groups) at("speed").textContent = `flown in ${(1e3 * told.seconds).toFixed(0)} ms, drawn in ${took.toFixed(0)} ms`;
      Object.assign(document.documentElement.dataset, {answered: id, milliseconds: took});
    }));
    if (due) ask();
  }

  function undo() {  // the effect that was added could not be flown
    if (fresh) remove(fresh);
    fresh = null;
  }

  function show(told) {
    whole = told.window;
    fresh = null;
    state.fan = at("fan").checked = told.fan;
    at("said").textContent = told.said;
    if (told.exported) at("exported").textContent = told.exported;
    at("note").textContent = told.note;
    const nats = told.gain.nats, counted = told.gain.inflation;
    at("gain").textContent = "Δ log likelihood " + (Math.abs(nats) < 0.05 ? "0" : (nats > 0 ? "+" : "−") + number(Math.abs(nats)))
      + " nats";
    at("gain").title = `Of the trajectories in the window, against the result; normal residuals, ${number(counted)} samples count for one`;
    table(told.scores);
    const now = JSON.stringify(told.groups);
    if (now !== built) build(told.groups);
    built = now;
    refresh();
    const [from, to] = state.window || whole;
    for (const [id, x] of [["from", from], ["to", to]]) {
      if (document.activeElement !== at(id)) at(id).value = Number(x.toFixed(2));
      at(id).min = whole[0];
      at(id).max = whole[1];
    }
  }

  function table(rows) {
    const cell = (kind, text, scope) => make(kind, text, scope ? {scope} : {});
    const line = (title, name, text) => make("tr", [cell("th", title, "row"), ...rows.map((r) => cell("td", text(r)))], {className: name});
    const share = (x) => x === null ? "" : (100 * x).toFixed(0) + " %";
    const head = make("tr", [make("td", ""), ...rows.map((r) => cell("th", r.label, "col"))]);
    const lines = [
      line("RMS result", "", (r) => number(r.before)), line("RMS now", "now", (r) => number(r.now)),
      line("inside result", "", (r) => share(r.within_before)), line("inside now", "now", (r) => share(r.within)),
    ];
    const caption = at("scores").querySelector("caption");
    at("scores").replaceChildren(caption, make("thead", head), make("tbody", lines));
  }

  function build(groups) {
    const focused = document.activeElement && document.activeElement.id;
    at("groups").replaceChildren(...groups.map(group));
    if (focused && at(focused)) at(focused).focus();
  }

  function group(g) {
    const box = make("input", [], {type: "checkbox", id: `on-${g.name}`, onchange: () => {
      state.off = state.off.filter((name) => name !== g.name).concat(box.checked ? [] : [g.name]);
      refresh();
      ask();
    }});
    const title = g.switch ? make("label", [box, " " + g.name]) : make("span", g.name);
    const legend = make("legend", Object.assign(title, {title: g.claim}));
    if (g.added) legend.append(make("button", "remove", {type: "button", ariaLabel: `remove ${g.name}`, onclick: () => { remove(g.name); ask(); }}));
    const set = make("fieldset", [legend, ...g.sliders.map(slider)]);
    set.dataset.effect = g.name;
    return set;
  }

  function slider(s) {
    const unit = s.unit === "-" ? "" : s.unit, span = s.high - s.low;
    const row = make("div", [], {className: "slider"});
    const step = span / 200;
    const name = `${s.name}${unit && " [" + unit + "]"}`;
    const range = make("input", [], {type: "range", id: `range-${s.name}`, ariaLabel: `${name}: ${s.description}`});
    Object.assign(range, {min: s.low, max: s.high, step});
    const field = make("input", [], {type: "number", id: `value-${s.name}`, step: "any", ariaLabel: `${name}, exact value`});
    const back = make("button", "↺", {type: "button", title: `reset ${s.name} to ${exact(s.value)}`, ariaLabel: `reset ${s.name}`});
    const set = (x) => { if (isFinite(x)) { state.values[s.name] = x; refresh(); ask(); } };
    range.oninput = () => set(range.valueAsNumber);
    field.onchange = () => set(field.valueAsNumber);
    field.onkeydown = (event) => {
      const sign = {ArrowUp: 1, ArrowDown: -1}[event.key];
      if (sign) { event.preventDefault(); set((state.values[s.name] ?? s.value) + sign * step); field.value = exact(state.values[s.name]); }
    };
    back.onclick = () => { delete state.values[s.name]; refresh(); ask(); };
    const track = make("div", range, {className: "track", title: s.error > 0 ? `${exact(s.value)} ± ${number(s.error)} ${unit}` : exact(s.value)});
    track.style.setProperty("--low", Math.max(0, (s.value - s.error - s.low) / span));
    track.style.setProperty("--width", (Math.min(s.high, s.value + s.error) - Math.max(s.low, s.value - s.error)) / span);
    row.append(make("label", s.name, {htmlFor: range.id, title: s.description}), track, field, make("span", unit, {title: unit}), back);
    row.refresh = () => {
      const x = state.values[s.name] ?? s.value;
      row.classList.toggle("moved", s.name in state.values);
      range.value = x;
      range.ariaValueText = `${number(x)} ${unit}`;
      if (document.activeElement !== field) field.value = exact(x);
      back.disabled = !(s.name in state.values);
    };
    return row;
  }

  function refresh() {
    for (const set of at("groups").querySelectorAll("fieldset")) {
      const off = state.off.includes(set.dataset.effect);
      set.classList.toggle("off", off);
      const box = set.querySelector("input[type=checkbox]");
      if (box) box.checked = !off;
      for (const row of set.querySelectorAll(".slider")) {
        row.refresh();
        for (const input of row.querySelectorAll("input")) input.disabled = off;
      }
    }
    for (const option of at("add").options) option.disabled = state.added.includes(option.value);
  }

  function remove(name) {
    state.added = state.added.filter((other) => other !== name);
    state.off = state.off.filter((other) => other !== name);
    const set = at("groups").querySelector(`fieldset[data-effect="${name}"]`);
    for (const row of set ? set.querySelectorAll("input[type=range]") : []) delete state.values[row.id.slice(6)];
  }

  function look(from, to) {  // the window of the plots; null: the whole record
    const all = near(from, whole[0]) && near(to, whole[1]);
    const next = all ? null : [from, to], old = state.window || whole;
    if (!(to > from) || near(from, old[0]) && near(to, old[1])) return;
    state.window = next;
    ask();
  }

  function start(exchanged, range) {
    exchange = exchanged;
    time = range;
    let zoomed = 0;
    for (const edge of ["start", "end"]) {
      time.properties[edge].change.connect(() => {
        clearTimeout(zoomed);
        zoomed = setTimeout(() => { if (!waiting) look(time.start, time.end); }, 80);
      });
    }
    exchange.properties.told.change.connect(answered);
    for (const line of Bokeh.documents[0].all_models) {  // Bokeh cuts lines at the frame in the lower layer alone
      if (line.level === "overlay" && line.type === "GlyphRenderer") Object.defineProperty(Bokeh.index.find_one(line), "needs_clip", {value: true});
    }
    at("manoeuvre").onchange = () => { Object.assign(state, {manoeuvre: Number(at("manoeuvre").value), window: null}); ask(); };
    at("from").onchange = at("to").onchange = () => {
      const [from, to] = [at("from").valueAsNumber, at("to").valueAsNumber];
      if (isFinite(from) && isFinite(to)) look(Math.max(from, whole[0]), Math.min(to, whole[1]));
    };
    at("whole").onclick = () => { state.window = null; ask(); };
    at("fan").onchange = () => { state.fan = at("fan").checked; ask(); };
    at("reset").onclick = () => { Object.assign(state, {values: {}, off: [], added: []}); refresh(); ask(); };
    at("adding").onclick = () => {
      const name = at("add").value;
      if (name && !state.added.includes(name)) { fresh = name; state.added = [...state.added, name]; ask(); }
    };
    at("export").onclick = () => { state.export = at("form").value; ask(); };
    show(JSON.parse(exchange.told));
    document.documentElement.dataset.answered = 0;
  }

  return {start, state};
})();
