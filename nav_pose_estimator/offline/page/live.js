// Turns the plots of a report into ones that zoom and answer to the pointer, where plotly.js lies beside the page.
// Without it the drawn plots stay. The data of a plot are those that `live.py` wrote; colours are the page's own.
(() => {
  "use strict";
  if (!window.Plotly) return;
  const color = (style) => getComputedStyle(document.documentElement).getPropertyValue(`--${style}`).trim();
  const numbers = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const first = (style) => style.split(" ")[0];

  const line = (one) => ({
    type: "scatter", mode: one.style.includes("points") ? "markers" : "lines",
    x: numbers(one.x), y: numbers(one.y), name: one.label, showlegend: Boolean(one.label),
    hoverinfo: one.label ? "all" : "skip", hovertemplate: one.label ? `%{y:.4~g}<extra>${one.label}</extra>` : undefined,
    line: { color: color(first(one.style)), width: one.style.includes("thick") ? 3 : 1.5,
      dash: one.style.includes("dash") ? "dash" : "solid" },
    marker: { color: color(first(one.style)), size: 5 },
  });
  const band = (one) => {
    const [x, low, high] = [one.x, one.low, one.high].map(numbers);
    const edge = { type: "scatter", mode: "lines", x, line: { width: 0 }, legendgroup: one.label };
    const fill = { fill: "tonexty", fillcolor: `${color(first(one.style))}38`, name: one.label };
    return [
      { ...edge, y: low, showlegend: false, hoverinfo: "skip" },
      { ...edge, ...fill, y: high, showlegend: Boolean(one.label), hoverinfo: one.label ? "all" : "skip",
        hovertemplate: one.label ? `%{y:.4~g}<extra>${one.label}</extra>` : undefined },
    ];
  };
  const dots = (marks) => ({
    type: "scatter", mode: "markers+text", x: marks.map((m) => m.x), y: marks.map((m) => m.y),
    text: marks.map((m) => m.text), textposition: "middle right", showlegend: false, hoverinfo: "skip",
    marker: { color: color("ink"), size: 8 },
  });
  // Where the vehicle was at the time that is pointed at in another plot; the last trace of a map and of a track.
  const here = (plot) => ({
    type: plot.kind === "track" ? "scatter3d" : "scatter", mode: "markers", name: "here", showlegend: false,
    hoverinfo: "skip", x: [], y: [], ...(plot.kind === "track" ? { z: [] } : {}),
    marker: { color: color("e"), size: plot.kind === "track" ? 6 : 11, line: { color: color("ink"), width: 1 } },
  });
  const axis = (title, more) => ({
    title: { text: title, standoff: 6, font: { size: 12 } }, gridcolor: color("rule"), linecolor: color("rule"),
    zerolinecolor: color("rule"), ...more,
  });
  const isNarrow = () => document.documentElement.clientWidth < 700;
  const common = (plot) => ({
    height: plot.height + 70, margin: { l: 48, r: 14, t: 48, b: isNarrow() ? 78 : 44 },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: color("soft"), size: 12 },
    hoverlabel: { font: { size: 12, color: color("ink") }, bgcolor: color("card") },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: color("soft"), activecolor: color("ink") },
    legend: isNarrow() ? { orientation: "h", x: 0, y: 0, yref: "container", yanchor: "bottom" }
      : { orientation: "h", x: 1, xanchor: "right", y: 1, yanchor: "bottom" },
  });
  // The unit stands above the axis, where it can be read and has room.
  const above = (text) => ({ text, x: 0, y: 1, xref: "paper", yref: "paper", xanchor: "left", yanchor: "bottom",
    yshift: 6, xshift: -36, showarrow: false, align: "left" });
  const flat = (plot) => ({
    traces: [...plot.bands.flatMap(band), ...plot.lines.map(line), ...(plot.marks.length ? [dots(plot.marks)] : []),
      ...(plot.equal ? [here(plot)] : [])],
    layout: {
      ...common(plot), hovermode: plot.equal ? "closest" : "x unified", dragmode: plot.equal ? "pan" : "zoom",
      xaxis: axis(plot.x_label, plot.equal ? {} : { showspikes: true, spikethickness: 1, spikecolor: color("soft") }),
      annotations: [above(plot.y_label)],
      yaxis: axis("", plot.equal ? { scaleanchor: "x" }
        : plot.log ? { type: "log", range: plot.y_range, dtick: plot.y_range[1] - plot.y_range[0] > 1.2 ? 1 : "D2" }
          : { range: plot.y_range }),
      shapes: plot.spans.map(([x0, x1]) => ({
        type: "rect", x0, x1, y0: 0, y1: 1, yref: "paper", line: { width: 0 }, fillcolor: color("shade"), opacity: 0.6,
        layer: "below",
      })),
    },
  });
  const solid = (plot) => {
    const title = (text) => axis(text, { title: { text }, backgroundcolor: "rgba(0,0,0,0)" });
    return {
      traces: [...plot.lines.map((one) => ({
        type: "scatter3d", mode: "lines", x: numbers(one.x), y: numbers(one.y), z: numbers(one.z), name: one.label,
        showlegend: Boolean(one.label), line: { color: color(first(one.style)), width: one.style.includes("thick") ? 7 : 3 },
        hovertemplate: "%{x:.1f} m East, %{y:.1f} m North, %{z:.1f} m up<extra></extra>",
      })), here(plot)],
      layout: {
        ...common(plot), margin: { l: 0, r: 0, t: 60, b: isNarrow() ? 40 : 0 },
        scene: { xaxis: title("East, m"), yaxis: title("North, m"), zaxis: title("Up, m"),
          aspectmode: "manual", aspectratio: plot.aspect, camera: { eye: { x: 0.8, y: -1.2, z: 0.8 }, center: { x: 0, y: 0, z: -0.12 } } },
      },
    };
  };

  const figures = [...document.querySelectorAll("figure.plot")].map((figure) => ({
    figure, target: figure.querySelector(".live"), plot: JSON.parse(figure.querySelector("script").textContent),
  }));
  const times = figures.filter(({ plot }) => plot.time)
    .flatMap(({ plot }) => plot.lines.flatMap(({ x }) => [...numbers(x)])).filter(Number.isFinite);
  const flight = times.reduce(([low, high], t) => [Math.min(low, t), Math.max(high, t)], [Infinity, -Infinity]);
  const draw = () => figures.forEach(({ figure, target, plot }) => {
    figure.hidden = false;
    figure.classList.add("is-live");
    const { traces, layout } = plot.kind === "track" ? solid(plot) : flat(plot);
    const range = target.layout && target.layout.xaxis && !target.layout.xaxis.autorange && target.layout.xaxis.range;
    if (range || plot.time) layout.xaxis.range = range || flight;
    Plotly.react(target, traces, layout, {
      responsive: true, displaylogo: false, displayModeBar: "hover", scrollZoom: plot.equal || plot.kind === "track",
      modeBarButtons: plot.kind === "track" ? [["toImage", "zoom3d", "pan3d", "orbitRotation", "resetCameraDefault3d"]]
        : [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]],
    });
  });
  draw();

  // Plots over time show the same time.
  const timed = figures.filter(({ plot }) => plot.time);
  let following = false;
  timed.forEach(({ target }) => target.on("plotly_relayout", (change) => {
    const moved = "xaxis.range[0]" in change || "xaxis.autorange" in change;
    if (following || !moved) return;
    following = true;
    const to = "xaxis.autorange" in change ? { "xaxis.autorange": true }
      : { "xaxis.range": [change["xaxis.range[0]"], change["xaxis.range[1]"]] };
    Promise.all(timed.filter((other) => other.target !== target).map((other) => Plotly.relayout(other.target, to)))
      .finally(() => { following = false; });
  }));
  // Pointing at a time shows the place.
  const track = figures.find(({ plot }) => plot.kind === "track");
  if (track) {
    const [t, x, y, z] = ["t", "x", "y", "z"].map((name) => numbers(track.plot.path[name]));
    const point = (time) => {
      const found = t.findIndex((one) => one >= time);
      const i = found < 0 ? t.length - 1 : found;
      figures.filter(({ plot }) => plot.equal || plot.kind === "track").forEach(({ target, plot }) => Plotly.restyle(
        target, { x: [[x[i]]], y: [[y[i]]], ...(plot.kind === "track" ? { z: [[z[i]]] } : {}) },
        [target.data.length - 1]));
    };
    timed.forEach(({ target }) => target.on("plotly_hover", ({ xvals, points }) => point(xvals ? xvals[0] : points[0].x)));
  }
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
})();
