(function () {
  "use strict";
  const items = JSON.parse(document.getElementById("plots").textContent);
  const places = Array.from(document.querySelectorAll("[data-plot]"));
  const views = new Map();

  const INK = "#222222";
  const TEXT = {axis_label_text_font_size: "13px", axis_label_text_font_style: "normal", axis_label_text_color: INK,
    major_label_text_font_size: "12px", major_label_text_color: INK, minor_tick_line_color: null};

  function numbers(text) {
    return new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  }

  function panel(item, shared, cross, last) {
    const box = new Bokeh.BoxZoomTool({dimensions: "width"});
    const pan = new Bokeh.PanTool({dimensions: "width"});
    const wheel = new Bokeh.WheelZoomTool({dimensions: "width", modifiers: {ctrl: true}});
    const others = [new Bokeh.ResetTool(), new Bokeh.SaveTool(), new Bokeh.CrosshairTool({overlay: cross})];
    const [start, end] = item.scale;
    const f = Bokeh.Plotting.figure({
      height: item.height, sizing_mode: "stretch_width", x_range: shared, y_range: new Bokeh.Range1d({start, end}),
      y_axis_label: item.label, x_axis_label: last ? "time from start of record [s]" : null, tools: [box, pan, wheel, ...others],
      background_fill_color: "#ffffff", border_fill_color: "#ffffff", outline_line_color: "#bbbbbb",
      min_border_left: 66, min_border_right: 8, min_border_top: 6, min_border_bottom: 6, tags: [item.printed],
    });
    const data = Object.fromEntries(Object.entries(item.columns).map(([key, text]) => [key, numbers(text)]));
    const source = new Bokeh.ColumnDataSource({data});
    const x = {field: "t"};
    const area = (y1, y2, fill_color, fill_alpha) =>
      f.varea(x, {field: y1}, {field: y2}, {source, fill_color, fill_alpha});
    if (item.band) area("low", "high", "#999999", 0.28);
    for (const [one, other] of item.shade) area("y" + one, "y" + other, item.lines[other].colour, 0.25);
    const lines = item.lines.map((line, i) => f.line(x, {field: "y" + i},
      {source, line_color: line.colour, line_dash: line.style, line_width: line.width}));
    const values = item.lines.map((line, i) => [line.label, `@y${i}{0.[0000]} ${line.unit}`.trim()]);
    f.add_tools(new Bokeh.HoverTool({
      renderers: [lines[0]], mode: "vline", tooltips: [["time", "@t{0.00} s"], ...values], line_policy: "nearest"}));
    for (const side of [...f.below, ...f.left]) side.setv(TEXT);
    for (const grid of f.center) grid.setv({grid_line_color: "#dddddd"});
    f.below[0].visible = last;
    f.left[0].ticker.desired_num_ticks = item.ticks;
    return {f, data, full: item.scale};
  }

  function fit(shared, [first, last], panels) {  // what is seen fills its panel, and never leaves the scale of all
    const whole = shared.start <= first && shared.end >= last;
    for (const {f, data, full: [bottom, top]} of panels) {
      let low = top, high = bottom;
      const {t, ...curves} = data;
      for (const y of Object.values(curves)) {
        for (let k = 0; k < t.length; k++) {
          if (t[k] >= shared.start && t[k] <= shared.end && isFinite(y[k])) {
            low = Math.min(low, y[k]);
            high = Math.max(high, y[k]);
          }
        }
      }
      low = Math.max(low, bottom);
      high = Math.min(high, top);
      const room = 0.06 * (high - low);
      const all = whole || !(high > low);
      f.y_range.setv(all ? {start: bottom, end: top} : {start: low - room, end: high + room});
    }
  }

  async function draw(place) {
    const {name, span, panels} = items[Number(place.dataset.plot)];
    const [start, end] = span;
    const shared = new Bokeh.Range1d({start, end, bounds: "auto", name});
    const look = {line_dash: "dotted", line_color: "#777777", line_width: 1};
    const cross = new Bokeh.Span({dimension: "height", ...look});
    const made = panels.map((item, i) => panel(item, shared, cross, i === panels.length - 1));
    for (const edge of ["start", "end"]) {  // a zoom to an end of the record moves one of them only
      shared.connect(shared.properties[edge].change, () => fit(shared, span, made));
    }
    const options = {sizing_mode: "stretch_width", toolbar_location: "above", merge_tools: true};
    const grid = Bokeh.Plotting.gridplot(made.map(({f}) => [f]), options);
    grid.toolbar.logo = null;
    grid.toolbar.tools[0].active = true;  // the box; else a drag pans
    views.set(place, [await Bokeh.Plotting.show(grid, place)]);
    const canvas = place.parentElement;
    const wake = document.createElement("button");  // a swipe on a phone scrolls the page until the plot is tapped
    wake.type = "button";
    wake.className = "wake";
    wake.innerHTML = "<span>tap to zoom</span>";
    wake.addEventListener("click", () => canvas.classList.add("awake"));
    canvas.append(wake);
  }

  const SHEET = 1040;  // pixels across a sheet: text is then as large as that of a table

  function drawn(view, place) {  // as broad as the sheet, whatever the window is, and low enough to share it
    const panels = view.model.children.map((child) => child[0]);
    const usual = panels.map((panel) => panel.height);
    const lay = (width, height, heights) => {
      place.style.width = width;
      place.style.height = height;  // else the page were shorter for a moment, and scrolled
      panels.forEach((panel, i) => panel.setv({height: heights[i]}, {silent: true}));
      view.invalidate_layout();
    };
    lay(SHEET + "px", place.offsetHeight + "px", panels.map((panel) => panel.tags[0]));
    try {
      return view.export("png", true).canvas;
    } finally {
      lay("", "", usual);
    }
  }

  function still(place) {  // a canvas of its own, for its size follows the paper while Bokeh's follows the window
    const view = (views.get(place) || []).find((one) => one.bbox && one.bbox.height > 0);  // not the notifications
    const old = place.parentElement.querySelector(".still");
    if (old) old.remove();
    if (!view) return;
    try {
      const copy = drawn(view, place);
      copy.className = "still";
      copy.removeAttribute("style");
      copy.setAttribute("aria-hidden", "true");
      place.parentElement.append(copy);
    } catch (reason) {
      console.warn("plot not printed: " + reason);
    }
  }

  function mark() {  // a picture hides the shadow that tells of what is beyond the edge
    for (const box of document.querySelectorAll(".box")) {
      box.classList.toggle("wider", box.scrollWidth > box.clientWidth + 2);
    }
  }
  window.addEventListener("resize", mark);
  window.addEventListener("load", mark);
  document.addEventListener("toggle", mark, true);  // what was folded has no width

  let opened = [];
  window.addEventListener("beforeprint", () => {
    opened = Array.from(document.querySelectorAll("details:not([open])"));
    for (const one of opened) one.open = true;
    places.forEach(still);
  });
  window.addEventListener("afterprint", () => {
    for (const one of opened) one.open = false;
  });

  (async function () {
    for (const place of places) await draw(place);
    document.documentElement.dataset.drawn = String(places.length);
  })();
})();
