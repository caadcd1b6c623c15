(function () {
  "use strict";
  const items = JSON.parse(document.getElementById("plots").textContent);
  const places = Array.from(document.querySelectorAll("[data-plot]"));
  const views = new Map();

  async function draw(place) {
    const found = await Bokeh.embed.embed_item(items[Number(place.dataset.plot)], place.id);
    views.set(place, Array.from(found));
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
